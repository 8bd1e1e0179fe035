"""The compiled mathematics of fusion. Cameras come as rows of `core.rig.packed_rig`, views without their lenses."""
