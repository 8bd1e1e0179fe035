"""The compiled mathematics of the whole-body fit: tree, Gauss-Newton step, filter and smoother.

State of one time step: q (nodes,) of slides and hinges, rot (nodes, 3, 3) of balls; its error lives in D local coordinates,
a ball's as a rotation vector in its own child axes (rot <- rot exp(d)). The filter's covariance is over (D errors,
D velocities). A keypoint's measurement of any kind is brought to information (3, 3) and gradient (3,) about its present
place, so that 3D points and the rays of all cameras enter the same normal equations.
"""

from .algebra import inverse, solve_rows, times_transposed
from .filter import absorb, add_point_variance, predict, smooth_step
from .live import moved_rays, ray_loss, stand, variance_factor, weighted_points
from .newton import SeenKeypoints, descend, gauss_newton, length_information, ray_information
from .tree import BALL, HINGE, SLIDE, Tree, derivative, difference, exp3, forward_kinematics, keypoints, log3, place, retract

__all__ = [
    "BALL",
    "HINGE",
    "SLIDE",
    "SeenKeypoints",
    "Tree",
    "absorb",
    "add_point_variance",
    "derivative",
    "descend",
    "difference",
    "exp3",
    "forward_kinematics",
    "gauss_newton",
    "inverse",
    "keypoints",
    "length_information",
    "log3",
    "moved_rays",
    "place",
    "predict",
    "ray_information",
    "ray_loss",
    "retract",
    "smooth_step",
    "solve_rows",
    "stand",
    "times_transposed",
    "variance_factor",
    "weighted_points",
]  # fmt: skip
