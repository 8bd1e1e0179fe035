"""The recorded run: a session folder to a Recording, in steps that can be run again."""
