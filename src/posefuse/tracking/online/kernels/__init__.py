"""The compiled mathematics of the asynchronous tracker: one view of one person at a time.

Times are seconds since the person's birth. Arrays that belong together are one named tuple: `SessionArrays`, `KeypointRays` of
one view, and `TrackState`, what is known of a person.
"""
