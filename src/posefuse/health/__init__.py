"""Is the rig still right? Moved, late, swapped and frozen cameras, used live and recorded."""
