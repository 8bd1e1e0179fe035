// Prints as JSON what libsdformat finds in a world file: cameras, models, actors, plug-ins, lights. Exits with 1 on any error.
#include <iostream>
#include <iomanip>
#include <sdf/sdf.hh>

static void pose(const ignition::math::Pose3d &p)
{
  std::cout << "\"xyz\": [" << p.Pos().X() << ", " << p.Pos().Y() << ", " << p.Pos().Z() << "], \"wxyz\": [" << p.Rot().W()
            << ", " << p.Rot().X() << ", " << p.Rot().Y() << ", " << p.Rot().Z() << "]";
}

int main(int, char **argv)
{
  sdf::Root root;
  // it passes by what it does not know otherwise
  auto strict = sdf::ParserConfig::GlobalConfig();
  strict.SetUnrecognizedElementsPolicy(sdf::EnforcementPolicy::ERR);
  const auto errors = root.Load(argv[1], strict);
  for (const auto &error : errors)
    std::cerr << error.Message() << "\n";
  if (!errors.empty() || root.WorldCount() != 1)
    return 1;
  const auto *world = root.WorldByIndex(0);
  std::cout << std::setprecision(17) << "{\"version\": \"" << root.Version() << "\", \"cameras\": [";
  std::string comma;
  for (uint64_t i = 0; i < world->ModelCount(); ++i)
  {
    const auto *model = world->ModelByIndex(i);
    const auto *link = model->LinkByIndex(0);
    if (!link->SensorCount())
      continue;
    const auto *sensor = link->SensorByIndex(0);
    const auto *camera = sensor->CameraSensor();
    // model, link and sensor lie in each other: the sensor's pose in the link, the link's in the model, the model's in the world
    const auto at = model->RawPose() * link->RawPose() * sensor->RawPose();
    std::cout << comma << "{\"name\": \"" << model->Name() << "\", \"topic\": \"" << sensor->Topic()
              << "\", \"rate_hz\": " << sensor->UpdateRate() << ", \"size\": [" << camera->ImageWidth() << ", "
              << camera->ImageHeight() << "], \"has_intrinsics\": " << camera->Element()->GetElement("lens")->HasElement("intrinsics")
              << ", \"f\": [" << camera->LensIntrinsicsFx() << ", " << camera->LensIntrinsicsFy() << "], \"c\": ["
              << camera->LensIntrinsicsCx() << ", " << camera->LensIntrinsicsCy() << "], \"skew\": " << camera->LensIntrinsicsSkew()
              << ", \"fov\": " << camera->HorizontalFov().Radian() << ", \"noise\": " << camera->ImageNoise().StdDev() << ", ";
    pose(at);
    std::cout << "}";
    comma = ", ";
  }
  std::cout << "], \"models\": [";
  comma.clear();
  for (uint64_t i = 0; i < world->ModelCount(); ++i)
  {
    const auto *model = world->ModelByIndex(i);
    const auto *visual = model->LinkByIndex(0)->VisualByIndex(0);
    if (!visual)
      continue;
    std::cout << comma << "{\"name\": \"" << model->Name() << "\", \"static\": " << model->Static() << ", ";
    pose(model->RawPose());
    const auto *geometry = visual->Geom();
    if (geometry->BoxShape())
    {
      const auto size = geometry->BoxShape()->Size();
      std::cout << ", \"size\": [" << size.X() << ", " << size.Y() << ", " << size.Z() << "]";
    }
    const auto colour = visual->Material()->Diffuse();
    std::cout << ", \"colour\": [" << colour.R() << ", " << colour.G() << ", " << colour.B() << "]}";
    comma = ", ";
  }
  std::cout << "], \"actors\": [";
  comma.clear();
  for (uint64_t i = 0; i < world->ActorCount(); ++i)
  {
    const auto *actor = world->ActorByIndex(i);
    std::cout << comma << "{\"name\": \"" << actor->Name() << "\", \"skin\": \"" << actor->SkinFilename() << "\", \"animation\": \""
              << actor->AnimationByIndex(0)->Filename() << "\", \"trajectories\": " << actor->TrajectoryCount()
              << ", \"loop\": " << actor->ScriptLoop() << ", \"delay\": " << actor->ScriptDelayStart()
              << ", \"auto\": " << actor->ScriptAutoStart() << ", ";
    pose(actor->RawPose());
    std::cout << "}";
    comma = ", ";
  }
  std::cout << "], \"lights\": " << world->LightCount() << ", \"step_s\": " << world->PhysicsDefault()->MaxStepSize() << "}\n";
  return 0;
}
