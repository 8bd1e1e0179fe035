"""The compiled mathematics of the asynchronous tracker: one view of one person at a time.

Times are seconds since the person's birth. Arrays that belong together are one named tuple: `SessionArrays`, `KeypointRays` of
one view, and `StateParts`, the parts of the flat array that a person is kept as.
"""
