"""What does not know cameras or people: safe writing, settings, compiled kernels, plug-ins, the platform."""
