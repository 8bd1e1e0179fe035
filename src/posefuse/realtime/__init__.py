"""The live pipeline: camera groups in processes of their own, one steady fusion loop, outputs next to it."""
