"""The operator's hand moves a robot: mapping, gate, limits, separation, robots; docs/teleoperation.md.

Two processes. The operator's side maps the hand to a target and decides whether the robot may move (`operator`).
The robot's side limits every motion and stops by itself when orders stop coming (`process`).
"""
