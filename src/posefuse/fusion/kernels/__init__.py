"""The compiled mathematics of fusion. Cameras come as rows of `cameras.packed_rig`, views without their lenses."""
