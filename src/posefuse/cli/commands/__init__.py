"""One module per command: SUMMARY, add_arguments(parser), run(args, terminal) -> figures."""
