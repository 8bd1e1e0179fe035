"""A real roscore in a network namespace that has nothing but loopback: fixtures of the tests that need ROS 1."""

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def ros1_python():
    """(the interpreter ROS 1 runs with, the folder its modules are in)."""
    roscore = shutil.which("roscore")
    if roscore is None:
        pytest.skip("ROS 1 is not installed (tools/system-packages.sh names the packages)")
    python = Path(roscore).resolve().read_text().splitlines()[0].removeprefix("#!").split()[-1]
    ask = "import rospy, rosbag, tf2_ros, sensor_msgs.msg, os; print(os.path.dirname(os.path.dirname(rospy.__file__)))"
    answer = subprocess.run([python, "-c", ask], capture_output=True, text=True, timeout=120)
    if answer.returncode:
        pytest.skip(f"ROS 1 is not complete: {answer.stderr.strip().splitlines()[-1]}")
    return python, answer.stdout.strip()


@pytest.fixture
def alone(tmp_path):
    """Starts programs in a namespace with only loopback; ends them all."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("network namespaces need root and `ip` (Debian: iproute2)")
    name = f"pfros{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, timeout=120)
    if made.returncode:
        pytest.skip(f"no network namespaces ({made.stderr.strip()})")
    subprocess.run(["ip", "-n", name, "link", "set", "lo", "up"], check=True, timeout=120)
    ros = {"ROS_MASTER_URI": "http://127.0.0.1:11311", "ROS_IP": "127.0.0.1"} | dict.fromkeys(
        ("ROS_HOME", "ROS_LOG_DIR"), str(tmp_path)
    )
    pipes, running = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}, []

    def start(*command):
        running.append(subprocess.Popen(["ip", "netns", "exec", name, *map(str, command)], env=os.environ | ros, **pipes))
        return running[-1]

    yield start
    for process in reversed(running):
        process.terminate()
    for process in running:
        process.communicate(timeout=20)
    subprocess.run(["ip", "netns", "del", name], check=True, timeout=120)


def wait_for_master(alone, python):
    """Start a roscore there and wait until it answers."""
    alone("roscore")
    deadline = time.monotonic() + 30
    ready = "import rosgraph, sys; sys.exit(not rosgraph.is_master_online())"
    while alone(python, "-c", ready).wait(20) and time.monotonic() < deadline:
        time.sleep(0.2)
