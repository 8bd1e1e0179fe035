"""Figures of teleoperation: `python bench/teleoperation.py STEP`, steps below; docs/explanation of each in docs/teleoperation.md.

faults    random fault sequences through mapping, gate, link and limits; breaches
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import sys
import time
from collections import Counter
from dataclasses import replace

import numpy as np

RATE_HZ = 100.0


def faults(robot: str, first: int, count: int, workers: int) -> int:
    """Sequences `first` to `first + count - 1`; prints breaches by kind. Returns how many there were."""
    from rehearsal.faults import Outcome, run_many

    begun_s = time.monotonic()
    parts = [(int(part[0]), len(part), robot) for part in np.array_split(np.arange(first, first + count), max(1, count // 500))]
    total = Outcome()
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for outcome in pool.starmap(run_many, parts, chunksize=1):
            total.add(outcome)
    kinds = dict(Counter(" ".join(breach.what.split()[:2]) for breach in total.breaches))
    seconds = time.monotonic() - begun_s
    print(
        f"{robot}, fault sequences {first} to {first + count - 1}: {len(total.breaches)} breaches {kinds}; "
        f"moved in {total.moved}; {seconds:.0f} s"
    )
    for when, (speed, fast, slow) in zip(("in time", "late"), total.physics, strict=True):
        if speed:
            print(f"  physics, process {when}: at most {speed:.2f} m/s, {fast:.1f} m/s2 over 10 ms, {slow:.1f} m/s2 over 50 ms")
    for breach in total.breaches[:10]:
        print(f"  sequence {breach.sequence} at {breach.t_s:.2f} s: {breach.what}")
    return len(total.breaches)


def follow() -> None:
    """In simulated time, so that the load of the machine does not matter; only IK times depend on it."""
    from rehearsal.figures import jitter_m, lag_and_rms, rms_jerk, spectral_arc_length
    from rehearsal.person import sine

    print("hand                   lag ms  rms mm  jitter mm  step mm  step rad  SPARC hand robot  jerk hand robot  IK p50 p99 ms")
    for speed_mps, noise_mm in ((0.1, 0.0), (0.3, 0.0), (0.5, 0.0), (0.3, 2.0), (0.3, 5.0)):
        hand, measured, robot, standing, steps, ik_ms = _followed(sine(speed_mps), 1e-3 * noise_mm)
        lag_s, rms_m = lag_and_rms(hand, robot, RATE_HZ)
        print(
            f"{speed_mps:.1f} m/s, {noise_mm:.0f} mm noise   {1e3 * lag_s:5.0f}  {1e3 * rms_m:6.1f}  "
            f"{1e3 * jitter_m(standing, RATE_HZ):9.2f}  {1e3 * steps[0]:7.3f}  {steps[1]:8.5f}  "
            f"{spectral_arc_length(measured, RATE_HZ):10.2f} {spectral_arc_length(robot, RATE_HZ):5.2f}  "
            f"{rms_jerk(measured, RATE_HZ):9.1f} {rms_jerk(robot, RATE_HZ):5.1f}  "
            f"      {np.percentile(ik_ms, 50):.2f} {np.percentile(ik_ms, 99):.2f}",
            flush=True,
        )


def _followed(path, noise_m: float, seconds: float = 16.0):
    """True hand, hand as measured, robot; the robot while the hand rests; steps at engaging; IK times."""
    from rehearsal.person import person_view

    from posefuse_teleop.follower import Driver
    from posefuse_teleop.gate import Beat
    from posefuse_teleop.mujoco_robot import MujocoRobot, mujoco_model, placed
    from posefuse_teleop.session import Operator, OperatorNews, step_operator
    from posefuse_teleop.settings import RobotSettings, TeleoperationSettings
    from posefuse_teleop.values import CameraReport, Phase

    settings = TeleoperationSettings(robot=RobotSettings(position_xy_m=(2.5, 0.0)))
    place = placed(settings.robot.position_xy_m, settings.robot.heading_deg)
    made = MujocoRobot(mujoco_model(None, settings.hands), ["right_hand"], settings.limits, place)
    follow_joints, times = made.joints.follow, []

    def timed(*arguments):
        begun = time.perf_counter()
        found = follow_joints(*arguments)
        times.append(1e3 * (time.perf_counter() - begun))
        return found

    made.joints.follow = timed
    driver, operator, rng, noise = Driver(made, settings), Operator(), np.random.default_rng(1), np.zeros(3)
    state, rows, standing, steps = replace(driver.state, sent_ns=10**12), [], [], (0.0, 0.0)
    for k in range(round((seconds + 6.0) * RATE_HZ)):
        now_ns, t_s = 10**12 + k * 10_000_000, k / RATE_HZ - 6.0
        hand = path(max(t_s, 0.0))
        # errors of networks last for some frames
        noise = 0.9 * noise + np.sqrt(1 - 0.9**2) * noise_m / np.sqrt(3) * rng.normal(size=3)
        measured_xyz = hand + noise + 1e-6 * rng.normal(size=3)
        view = person_view(measured_xyz, now_ns, measured_ns=now_ns - 40_000_000, sigma_m=noise_m / np.sqrt(3))
        heartbeats = (Beat(seq=k, sent_ns=now_ns),) if t_s > -5.5 else ()
        news = OperatorNews(view=view, heartbeats=heartbeats, cameras=CameraReport(t_ns=now_ns, healthy=4, total=4), robot=state)
        was, before = operator.gate.phase, state
        operator, order = step_operator(operator, news, now_ns, settings)
        state = driver.step([order] if order else [], now_ns)
        if operator.gate.phase is Phase.ENGAGED and was is Phase.READY:
            steps = (
                float(np.linalg.norm(state.measured_xyz_world - before.measured_xyz_world)),
                float(np.abs(state.q_rad - before.q_rad).max()),
            )
        if -4.0 < t_s < 0.0:
            standing.append(state.measured_xyz_world[0])
        if t_s > 1.0:
            rows.append((hand, hand + noise, state.measured_xyz_world[0]))
    hands, measured, robot = (np.array([row[i] for row in rows]) for i in range(3))
    return hands, measured, robot, np.array(standing), steps, times


def live(session_folder, networks: str | None) -> None:
    """The live pipeline in the loop; the true hand comes from the simulated session."""
    from pathlib import Path

    from rehearsal.figures import jitter_m, lag_and_rms, rms_jerk, spectral_arc_length

    import posefuse as pf
    from posefuse.core.skeleton import pick_keypoints
    from posefuse.formats.truth import read_truth
    from posefuse_sim import SessionPaths
    from posefuse_teleop.gate import Beat
    from posefuse_teleop.settings import RobotSettings, TeleoperationSettings
    from posefuse_teleop.switches import Pressed

    class Held:
        """A switch that is held from a while after the first pose."""

        hint, seq, first_ns = "held by the bench", 0, None

        def poll(self, now_ns, view):
            self.first_ns = now_ns if self.first_ns is None and view is not None else self.first_ns
            self.seq += 1
            held = self.first_ns is not None and now_ns - self.first_ns > 1e9
            return Pressed(heartbeats=(Beat(seq=self.seq, sent_ns=now_ns),) if held else ())

        def close(self):
            pass

    rows = []

    def watch(operator, order):
        if operator.view is not None and operator.robot is not None:
            view, robot = operator.view, operator.robot
            rows.append(
                (
                    time.monotonic_ns(),
                    view.t_ns,
                    *view.xyz_world[0],
                    view.sigma_m[0],
                    robot.sent_ns,
                    *robot.measured_xyz_world[0],
                    operator.gate.phase == "engaged",
                )
            )

    settings = TeleoperationSettings(robot=RobotSettings(position_xy_m=(2.5, 0.0)))
    folder = Path(session_folder)
    truth = read_truth(SessionPaths(folder).truth)
    hand = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, ["right_wrist"])[:, 0]
    cameras = pf.live(folder / "rig.toml", [f"sim:{folder}"], networks=networks)
    done = pf.teleoperate(cameras, deadman=Held(), settings=settings, watch=watch, progress=True)
    table = np.array(rows, float)
    print(f"phases {dict(done.ticks)}, engaged {done.engagements} times, reasons {done.reasons.most_common(5)} {done.fault}")
    if len(done.latency_ms) > 20:
        p50, p95 = np.percentile(done.latency_ms, [50, 95])
        print(f"mid-exposure to command: p50 {p50:.0f} ms, p95 {p95:.0f} ms, {len(done.latency_ms)} commands")
    sigma_mm = 1e3 * np.nanpercentile(table[:, 5], [50, 95])
    print(f"stated sigma of the hand: p50 {sigma_mm[0]:.0f} mm, p95 {sigma_mm[1]:.0f} mm")
    _print_following(table, truth.t_ns, hand, (lag_and_rms, jitter_m, spectral_arc_length, rms_jerk))


def _print_following(table, truth_ns, hand, figures) -> None:
    """Robot and fused hand against the true one, over the longest time engaged; session time 0 is found by the fused hand."""
    lag_and_rms, jitter_m, spectral_arc_length, rms_jerk = figures
    engaged = table[:, -1] > 0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], engaged, [False]]).astype(int)))
    if not len(edges):
        print("the robot was never engaged")
        return
    begin, end = max(edges.reshape(-1, 2), key=lambda pair: pair[1] - pair[0])
    part = table[begin:end]
    t_s = np.arange(part[0, 0], part[-1, 0], 1e9 / RATE_HZ) / 1e9
    if len(t_s) < 1.5 * RATE_HZ:
        print(f"engaged for {len(t_s) / RATE_HZ:.1f} s at most: too short to compare")
        return
    measured = np.stack([np.interp(t_s, part[:, 1] / 1e9, part[:, 2 + i]) for i in range(3)], axis=1)
    robot = np.stack([np.interp(t_s, part[:, 6] / 1e9, part[:, 7 + i]) for i in range(3)], axis=1)

    def true_hand(zero_s):
        return np.stack([np.interp(t_s - zero_s, truth_ns / 1e9, hand[:, i]) for i in range(3)], axis=1)

    def misfit(zero_s):
        error = true_hand(zero_s) - measured
        return float((error - error.mean(axis=0)).std())

    guess = t_s[0] - np.arange(0.0, truth_ns[-1] / 1e9, 0.005)
    true = true_hand(min(guess, key=misfit))
    for name, path in (("fused hand", measured), ("robot", robot)):
        lag_s, rms_m = lag_and_rms(true, path, RATE_HZ)
        print(
            f"{name:10s} against the true hand over {len(t_s) / RATE_HZ:.1f} s: lag {1e3 * lag_s:.0f} ms, "
            f"rms {1e3 * rms_m:.1f} mm, SPARC {spectral_arc_length(path, RATE_HZ):.2f} "
            f"(true {spectral_arc_length(true, RATE_HZ):.2f}), jerk {rms_jerk(path, RATE_HZ):.0f} m/s3"
        )
    slow = np.linalg.norm(np.gradient(true, axis=0), axis=1) * RATE_HZ < 0.01
    if slow.sum() > RATE_HZ:
        print(f"jitter of the robot while the hand rests: {1e3 * jitter_m(robot[slow], RATE_HZ):.2f} mm")


def boxes(seeds: int) -> None:
    """In simulated time: success, time and path error next to perfect tracking."""
    from rehearsal.boxes import MadeUpHand, move_boxes

    print(_BOXES_HEAD)
    for noise_mm in (0.0, 5.0, 10.0, 20.0):
        done = [move_boxes(MadeUpHand(1e-3 * noise_mm, seed)) for seed in range(seeds if noise_mm else 1)]
        _boxes_row(f"{noise_mm:.0f} mm of noise" if noise_mm else "perfect", done)


_BOXES_HEAD = "tracking                       boxes on their marks  seconds  path rms mm  lag ms  holds"


def _boxes_row(name: str, done) -> None:
    print(
        f"{name:30s} {sum(one.placed for one in done):9d} of {sum(one.of for one in done):2d}  "
        f"{done[0].seconds:13.1f}  {1e3 * np.mean([one.path_rms_m for one in done]):11.1f}  "
        f"{1e3 * np.mean([one.lag_s for one in done]):6.0f}  {sum(one.holds for one in done):5d}",
        flush=True,
    )


def boxes_rendered(folder, count: int, rate_hz: float, networks: str, latency_s: float, seed: int) -> None:
    """The same task, the operator seen by rendered cameras and a network; simulated time. `folder` keeps what was rendered."""
    from pathlib import Path

    from rehearsal.boxes import move_boxes
    from rendered_operator import BEGIN_S, SeenHand, rendered

    folder = Path(folder)
    rendered(folder, count, rate_hz, seed, lambda done, total: print(f"\rrendered {done} of {total}", end="", file=sys.stderr))
    print(file=sys.stderr)
    print(_BOXES_HEAD)
    _boxes_row("perfect", [move_boxes(boxes=count, begin_s=BEGIN_S)])
    hand = SeenHand(folder, networks, latency_s)
    _boxes_row(f"4 cameras, {networks}", [move_boxes(hand, boxes=count, begin_s=BEGIN_S)])
    _print_hand(hand.rows)


def _print_hand(rows) -> None:
    """Error of the tracked hand by its stated standard deviation; what is the same all the time moves no robot."""
    sigma_m = np.array([row[0] for row in rows])
    off_m = np.array([row[1] for row in rows])
    off_m = off_m - np.median(off_m, axis=0)
    far_mm = 1e3 * np.linalg.norm(off_m, axis=1)
    print("stated sigma mm   share %  error of the displacement: rms, p95, p99 mm")
    for low, high in itertools.pairwise((0.0, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 1.0)):
        inside = (sigma_m >= low) & (sigma_m < high)
        if inside.sum() > 20:
            p95, p99 = np.percentile(far_mm[inside], [95, 99])
            rms = np.sqrt((far_mm[inside] ** 2).mean())
            print(f"{1e3 * low:5.0f} to {1e3 * high:4.0f}  {100 * inside.mean():12.1f}  {rms:6.1f} {p95:6.1f} {p99:6.1f}")


def video(out) -> None:
    from pathlib import Path

    from rehearsal.video import draw_boxes

    for path in draw_boxes(Path(out)):
        print(path)


def kill(repeats: int) -> None:
    """Real processes: orders at 100 Hz move the robot at full speed, then something is killed."""
    print("fault                                                      standing after ms (median, worst)")
    for what in ("operator's process killed (-9)", "operator's process stopped (-STOP)", "operator's side goes silent"):
        times = [_time_to_stand(what) for _ in range(repeats)]
        print(f"{what:58s} {np.median(times):5.0f} {max(times):5.0f}", flush=True)


def kill_session(repeats: int, session: str) -> None:
    """Real processes of a whole session: cameras (an oracle for the network), fusion, outputs, robot."""
    from pathlib import Path

    from killed_session import FAULTS, ms_until_standing

    print("fault, 4 cameras in one process                            standing after ms (median, worst)")
    for what in FAULTS:
        times = [ms_until_standing(what, Path(session)) for _ in range(repeats)]
        known = [one for one in times if one is not None]
        shown = f"{np.median(known):5.0f} {max(known):5.0f}" if known else ""
        print(f"{what:58s} {shown}{'' if len(known) == len(times) else f' moved on in {len(times) - len(known)}'}", flush=True)


def _time_to_stand(what: str) -> float:
    """Milliseconds from the fault until the robot stands, by the robot process's own recording of its states."""
    import os
    import signal
    import tempfile
    from pathlib import Path

    from posefuse_ros.bags import read_mcap
    from posefuse_ros.messages import ns_from_time

    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "robot.mcap"
        context = multiprocessing.get_context("spawn")
        receiving, sending = context.Pipe(duplex=False)
        boss = context.Process(target=_boss, args=(record, sending, what.endswith("silent")))
        boss.start()
        robot_pid = receiving.recv()
        fault_ns = receiving.recv()
        if "killed" in what or "stopped" in what:
            fault_ns = time.time_ns()
            os.kill(boss.pid, signal.SIGKILL if "killed" in what else signal.SIGSTOP)
        time.sleep(2.0)
        os.kill(boss.pid, signal.SIGKILL)
        boss.join()
        _wait_gone(robot_pid)
        places = [
            (ns_from_time(one.msg.header.stamp), np.array([getattr(one.msg.pose.position, axis) for axis in "xyz"]))
            for one in read_mcap(record, {"/posefuse/teleoperation/right/commanded"})
        ]
        moving = [t_ns for (_, a), (t_ns, b) in itertools.pairwise(places) if np.linalg.norm(b - a) > 1e-7 and t_ns > fault_ns]
        return (max(moving, default=fault_ns) - fault_ns) / 1e6


def _wait_gone(pid: int) -> None:
    import os

    for _ in range(500):
        try:
            os.kill(pid, 0)
        except OSError:
            return
        time.sleep(0.01)


def _boss(record, sending, silent: bool) -> None:
    """An operator's side that drives the robot forward at full speed until something happens to it."""
    from posefuse_teleop.process import RobotLink, RobotPlan
    from posefuse_teleop.settings import TeleoperationSettings
    from posefuse_teleop.values import Order, Phase

    link = RobotLink(RobotPlan(settings=TeleoperationSettings(), record=record))
    link.wait_ready()
    sending.send(link.pid)
    seq, begun_s, said = 0, time.monotonic(), False
    while True:
        time.sleep(0.01)
        link.poll()
        seq += 1
        target = link.state.xyz_world + [0.1, 0.0, 0.0]
        if not said and np.linalg.norm(link.state.velocity_world) > 0.25 and time.monotonic() - begun_s > 0.3:
            said = True
            sending.send(time.time_ns())
        if said and silent:
            continue
        link.send(
            Order(
                seq=seq,
                sent_ns=time.monotonic_ns(),
                phase=Phase.ENGAGED,
                xyz_world=target,
                wxyz=link.state.wxyz,
                speed_mps=0.5,
                grip=np.array([False]),
            )
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    steps = parser.add_subparsers(dest="step", required=True)
    fault = steps.add_parser("faults")
    fault.add_argument("--robot", choices=("point", "own", "fixed", "two arms"), default="own")
    fault.add_argument("--first", type=int, default=0)
    fault.add_argument("--count", type=int, default=20_000)
    fault.add_argument("--workers", type=int, default=2)
    steps.add_parser("follow")
    on = steps.add_parser("live")
    on.add_argument("session", help="folder: posefuse simulate examples/scenes/operator.yaml --out FOLDER")
    on.add_argument("--networks")
    task = steps.add_parser("boxes")
    task.add_argument("--seeds", type=int, default=3, help="without --rendered: tasks per row")
    task.add_argument("--rendered", metavar="FOLDER", help="with rendered cameras and a network; what is rendered is kept there")
    task.add_argument("--count", type=int, default=2, help="with --rendered: boxes to move")
    task.add_argument("--rate", type=float, default=15.0, help="with --rendered: frames per second of each camera")
    task.add_argument("--networks", default="blazepose_lite")
    task.add_argument("--latency", type=float, default=0.06, help="with --rendered: from mid-exposure to a detection, s")
    task.add_argument("--seed", type=int, default=0, help="with --rendered: of the operator's sway")
    steps.add_parser("video").add_argument("--out", default=".", help="existing folder")
    killed = steps.add_parser("kill")
    killed.add_argument("--repeats", type=int, default=5)
    killed.add_argument("--session", metavar="FOLDER", help="of `posefuse simulate`: kill processes of a session on it instead")
    options = parser.parse_args()
    if options.step == "faults":
        return int(faults(options.robot, options.first, options.count, options.workers) > 0)
    if options.step == "follow":
        follow()
    if options.step == "live":
        live(options.session, options.networks)
    if options.step == "boxes" and options.rendered:
        boxes_rendered(options.rendered, options.count, options.rate, options.networks, options.latency, options.seed)
    elif options.step == "boxes":
        boxes(options.seeds)
    if options.step == "video":
        video(options.out)
    if options.step == "kill" and options.session:
        kill_session(options.repeats, options.session)
    elif options.step == "kill":
        kill(options.repeats)
    return 0


if __name__ == "__main__":
    sys.exit(main())
