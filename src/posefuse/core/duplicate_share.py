"""When two detections of one view are one body; apart from the code that uses it, because settings import nothing heavy."""

# A landmark network that looks twice at one body differs by 1 to 3 % of the box; two people one behind the other who coincide to
# 8 % cannot be distinguished in that view anyway.
DUPLICATE_SHARE = 0.08
