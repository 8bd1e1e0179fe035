import subprocess
import sys


def test_nothing_heavy_is_imported_before_it_is_used():
    """`posefuse --help` and the list of plug-ins import these modules."""
    program = (
        "import sys\n"
        "import posefuse.messages.dds, posefuse.messages.ros1, posefuse.messages.bags, posefuse.messages.osc, posefuse.messages.streams\n"
        "import posefuse.messages.ros_output, posefuse.messages.idl, posefuse.sources.ros, posefuse.outputs.mcap\n"
        "print(sorted({'cyclonedds', 'rosbags', 'mcap', 'rospy'} & set(sys.modules)))\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
