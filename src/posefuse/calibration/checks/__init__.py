"""How true a rig is, measured with a target or a recording that it was not made from."""
