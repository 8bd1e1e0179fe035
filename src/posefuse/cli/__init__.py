"""Config, plug-in lookup, pipelines and the command line."""
