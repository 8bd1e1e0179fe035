// What Gazebo's own COLLADA reader makes of an actor's file, as JSON lines: first its joints, then per time their poses in the
// world, and at the last time where its skin is. Usage: dae_actor FILE.dae TIME_S...
#include <cstdlib>
#include <iomanip>
#include <iostream>
#include <ignition/common/ColladaLoader.hh>
#include <ignition/common/Material.hh>
#include <ignition/common/Mesh.hh>
#include <ignition/common/NodeAnimation.hh>
#include <ignition/common/Skeleton.hh>
#include <ignition/common/SkeletonAnimation.hh>
#include <ignition/common/SkeletonNode.hh>
#include <ignition/common/SubMesh.hh>

using ignition::math::Matrix4d;

static void print(const Matrix4d &m)
{
  std::cout << "[";
  for (int r = 0; r < 4; ++r)
    for (int c = 0; c < 4; ++c)
      std::cout << (r + c ? ", " : "") << m(r, c);
  std::cout << "]";
}

// as Gazebo's scene does: each joint in its parent, from the animation of the file itself
static std::map<std::string, Matrix4d> inWorld(const ignition::common::SkeletonPtr &skeleton, double time)
{
  const auto local = skeleton->Animation(0)->PoseAt(time, true);
  std::map<std::string, Matrix4d> world;
  for (unsigned int h = 0; h < skeleton->NodeCount(); ++h)
  {
    Matrix4d pose = Matrix4d::Identity;
    for (auto *node = skeleton->NodeByHandle(h); node; node = node->Parent())
    {
      const auto moved = local.find(node->Name());
      pose = (moved == local.end() ? node->Transform() : moved->second) * pose;
    }
    world[skeleton->NodeByHandle(h)->Name()] = pose;
  }
  return world;
}

int main(int argc, char **argv)
{
  ignition::common::ColladaLoader loader;
  auto *mesh = loader.Load(argv[1]);
  if (!mesh || !mesh->HasSkeleton() || mesh->MeshSkeleton()->AnimationCount() != 1)
    return 1;
  const auto skeleton = mesh->MeshSkeleton();
  std::cout << std::setprecision(12) << "{\"root\": \"" << skeleton->RootNode()->Name() << "\", \"joints\": " << skeleton->NodeCount()
            << ", \"length_s\": " << skeleton->Animation(0)->Length() << ", \"min\": [" << mesh->Min().X() << ", " << mesh->Min().Y()
            << ", " << mesh->Min().Z() << "], \"max\": [" << mesh->Max().X() << ", " << mesh->Max().Y() << ", " << mesh->Max().Z()
            << "], \"colours\": [";
  for (unsigned int i = 0; i < mesh->MaterialCount(); ++i)
  {
    const auto colour = mesh->MaterialByIndex(i)->Diffuse();
    std::cout << (i ? ", " : "") << "[" << colour.R() << ", " << colour.G() << ", " << colour.B() << "]";
  }
  std::cout << "]}\n";
  std::map<std::string, Matrix4d> world;
  for (int i = 2; i < argc; ++i)
  {
    world = inWorld(skeleton, std::atof(argv[i]));
    std::string comma;
    std::cout << "{";
    for (const auto &[name, pose] : world)
    {
      std::cout << comma << "\"" << name << "\": ";
      print(pose);
      comma = ", ";
    }
    std::cout << "}\n";
  }
  std::cout << "[";
  std::string comma;
  unsigned int most = 0;
  for (unsigned int s = 0; s < mesh->SubMeshCount(); ++s)
  {
    const auto sub = mesh->SubMeshByIndex(s).lock();
    std::vector<ignition::math::Vector3d> places(sub->VertexCount());
    std::vector<double> total(sub->VertexCount());
    std::vector<unsigned int> count(sub->VertexCount());
    for (unsigned int a = 0; a < sub->NodeAssignmentsCount(); ++a)
    {
      const auto held = sub->NodeAssignmentByIndex(a);
      const auto *node = skeleton->NodeByHandle(held.nodeIndex);
      const auto bound = world[node->Name()] * node->InverseBindTransform() * sub->Vertex(held.vertexIndex);
      places[held.vertexIndex] += bound * held.weight;
      total[held.vertexIndex] += held.weight;
      most = std::max(most, ++count[held.vertexIndex]);
    }
    for (unsigned int v = 0; v < places.size(); ++v)
    {
      if (std::abs(total[v] - 1) > 1e-5)
        return 2;
      std::cout << comma << "[" << places[v].X() << ", " << places[v].Y() << ", " << places[v].Z() << "]";
      comma = ", ";
    }
  }
  std::cout << "]\n";
  return most > 4 ? 3 : 0;
}
