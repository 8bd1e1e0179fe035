"""The paper's experiments: scenes, the paper's own numbers, statistics, pages."""
