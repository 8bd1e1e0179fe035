"""A flood of messages over real DDS against a running fusion node."""

import json
import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from own_domain import own_domain
from running import Running

pytest.importorskip("cyclonedds")

from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.formats.rig import read_rig
from posefuse.tracking.warm_up import made_up_detections
from posefuse_ros import topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import message_from_detections

pytestmark = [pytest.mark.slow, pytest.mark.realtime]
DOMAIN = own_domain()
LATENCY_S, AFTER_S, PATIENCE_S = 0.03, 6.0, 400.0
COUNT = 10_000


def test_ten_thousand_messages_do_not_harm_a_running_fusion_node(demo_session: Path) -> None:
    rig_file = demo_session / "rig.toml"
    rig = read_rig(rig_file)
    command = [sys.executable, "-m", "posefuse.cli.main", "node", "fusion", str(rig_file), "--json"]
    flooder, sent = None, dict.fromkeys(rig.names, 0)
    with ExitStack() as running:
        fusion = running.enter_context(Running([*command, "--local-only", "--domain", str(DOMAIN)]))
        fusion.err.wait_for("waiting for views", PATIENCE_S)
        with RosNode("cameras", Network(domain_id=DOMAIN, local_only=True)) as node:
            poses, heard = node.reader(topics.POSE), 0
            begun_s, end_s = time.monotonic(), None
            zero_ns = time.time_ns()
            # a person who is made up, at the pace of the clock
            for step in made_up_detections(rig, BLAZEPOSE33, 100_000, start_ns=zero_ns):
                for view in step:
                    time.sleep(max(0.0, (view.t_ns - time.time_ns()) / 1e9 + LATENCY_S))
                    stages = {"received": view.t_ns + 10_000_000}
                    node.publish(topics.DETECTIONS, message_from_detections(view, stages), view.t_ns)
                    # those before the session began are not tracked
                    sent[view.camera] += heard > 0
                now_s, heard = time.monotonic(), heard + len(poses.take())
                # under way for some seconds
                if flooder is None and heard > 300:
                    script = str(Path(__file__).with_name("flooder.py"))
                    flooder = running.enter_context(Running([sys.executable, script, str(DOMAIN), str(COUNT), str(rig_file)]))
                if flooder is not None and end_s is None and flooder.process.poll() is not None:
                    end_s = now_s + AFTER_S
                assert now_s - begun_s < PATIENCE_S
                if end_s is not None and now_s > end_s:
                    break
        fusion.process.send_signal(signal.SIGINT)
        out, err = fusion.finished()
    assert fusion.process.returncode == 0, err
    assert "Traceback" not in err
    figures = json.loads(out)
    refused = figures["messages"]["refused"] + sum(figures["not_used"].values()) + sum(figures["strangers"].values())
    # the result of the flood was counted, and said
    assert refused > 200
    assert "floods the network" in err
    # every camera continued, and was never blamed
    for name, count in sent.items():
        assert figures["cameras"][name]["state"] == "ok"
        assert figures["cameras"][name]["used"] > 0.5 * count
    assert figures["poses_with_people"] > 0.5 * figures["poses"]
