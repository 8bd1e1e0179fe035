"""A made-up operator, faults on purpose and a judge: for tests, benches, and everyone who changes a limit."""
