"""How long errors of a 2D network last: the one place of the figures, for the smoother and the live tracker.

A network that marks a joint a little too high does so in the next frame too. Of the variance of a measurement's error a share
lasts, fading by e within a time; the rest is new in every frame. Averaging over time only helps against the rest.

Fitted to the default network's fused joints at 30 frames/s on rendered people who appear in no reported measurement:
`bench/fit_lasting_errors.py` prints 0.91 and 0.27 s. More than half of the share stays for good there; it counts as lasting
here, which is the same within the fraction of a second that is averaged over.
"""

from __future__ import annotations

LASTING_SHARE = 0.9
LASTING_S = 0.27
