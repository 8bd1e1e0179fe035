"""The compiled mathematics of fusion. Cameras come as rows of `packed.packed_rig`."""
