"""Gazebo in and out: a scene as a world that Gazebo opens, with exact truth by simulation time (docs/gazebo.md)."""

from .export import GazeboWorld, export_world
