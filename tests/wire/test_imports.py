import subprocess
import sys


def test_nothing_heavy_is_imported_before_it_is_used():
    """`posefuse --help` and the list of plug-ins import these modules."""
    program = (
        "import sys\n"
        "import posefuse.wire.dds, posefuse.wire.ros1, posefuse.wire.bags, posefuse.wire.osc, posefuse.wire.streams\n"
        "import posefuse.wire.ros_output, posefuse.wire.idl, posefuse.sources.ros, posefuse.sinks.mcap\n"
        "print(sorted({'cyclonedds', 'rosbags', 'mcap', 'rospy'} & set(sys.modules)))\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
    assert run.stdout.strip() == "[]"
