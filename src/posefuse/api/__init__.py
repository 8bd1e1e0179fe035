"""The public interface: recordings, rigs and the functions that make them, as exported by `import posefuse`."""
