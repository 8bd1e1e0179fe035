"""Nodes on two machines (network namespaces), without multicast, over links that lose, delay and break."""

import json
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest
from running import Lines

pytestmark = pytest.mark.realtime

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

TRAFFIC = str(Path(__file__).with_name("traffic.py"))
DOMAIN = "77"


def run(two, count, peers=True, hearing=1, while_sending=lambda: None):
    """Numbers heard of `count` sent from machine 0 to machine `hearing`, and their ages in s."""
    a, b = two.addresses if peers else ("", "")
    hearer = two.start(hearing, sys.executable, TRAFFIC, "hear", DOMAIN, a, "600")
    sender = two.start(0, sys.executable, TRAFFIC, "send", DOMAIN, b, str(count))
    lines, hearing_lines = Lines(sender.stdout), Lines(hearer.stdout)
    try:
        lines.wait_for("matched", 120.0)
        while_sending()
        lines.wait_for("done", 120.0)
        sender.wait(30)
    finally:
        sender.kill()
        hearer.kill()
        heard = [json.loads(line) for line in hearing_lines.rest().splitlines()]
    return [number for number, _ in heard], [age_ns * 1e-9 for _, age_ns in heard]


@pytest.mark.parametrize("peers", [True, False], ids=["address", "multicast"])
def test_two_machines_find_each_other_by(machines, peers):
    numbers, _ = run(machines, 120, peers=peers)
    assert numbers[-70:] == list(range(50, 120))


@pytest.mark.parametrize("peers", [True, False])
def test_nodes_on_one_machine_of_several(machines, peers):
    """Found by themselves, over the network card's address, with or without multicast, quietly while the other is away."""
    machines.cut = True
    numbers, _ = run(machines, 100, peers=peers, hearing=0)
    assert numbers[-50:] == list(range(50, 100))


def test_five_percent_loss_and_fifty_ms_delay(machines):
    machines.loss, machines.delay_s = 0.05, 0.05
    numbers, ages = run(machines, 300)
    assert numbers == sorted(set(numbers))
    # a pose takes three packets, and one lost loses it: 0.95 ** 3 arrive
    assert 0.95**3 - 0.07 < len(numbers) / 300 < 0.95**3 + 0.07
    assert numbers[-1] > 280
    assert min(ages) >= 0.05


def test_a_link_cut_and_back(machines):
    def cut():
        time.sleep(0.5)
        machines.cut = True
        time.sleep(1)
        machines.cut = False

    numbers, _ = run(machines, 400, while_sending=cut)
    assert (numbers[0], numbers[-1]) == (0, 399)
    assert numbers == sorted(set(numbers))
    gap = max(b - a for a, b in pairwise(numbers))
    assert 80 < gap < 300
