import subprocess
import sys


def test_nothing_heavy_is_imported_before_it_is_used():
    """`posefuse --help` and the list of plug-ins import these modules."""
    program = (
        "import sys\n"
        "from posefuse_ros import bags, dds, ros1, ros_output, types\n"
        "import posefuse_ros.source, posefuse_ros.mcap_output\n"
        "print(sorted({'cyclonedds', 'rosbags', 'mcap', 'rospy'} & set(sys.modules)))\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
    assert run.stdout.strip() == "[]"
