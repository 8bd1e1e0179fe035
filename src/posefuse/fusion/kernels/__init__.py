"""The compiled mathematics of fusion. Cameras come as rows of `lens.packed_rig`."""
