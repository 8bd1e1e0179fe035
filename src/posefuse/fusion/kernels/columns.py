"""Columns of a packed camera, by name; numba takes them as constants. What they hold is packed in `fusion.triangulation`."""

# cam_from_world: rotation by rows, translation
R00, R01, R02, R10, R11, R12, R20, R21, R22 = range(9)
TX, TY, TZ = 9, 10, 11
# intrinsic matrix
FX, SKEW, CX, FY, CY = 12, 13, 14, 15, 16
# distortion in the order of OpenCV; of a fisheye its four coefficients
K1, K2, P1, P2, K3, K4, K5, K6, S1, S2, S3, S4 = range(17, 29)
F1, F2, F3, F4 = K1, K2, P1, P2
# homography of a tilted sensor by rows, and its inverse
T00, T01, T02, T10, T11, T12, T20, T21, T22 = range(29, 38)
U00, U01, U02, U10, U11, U12, U20, U21, U22 = range(38, 47)
# one of the lens models below
MODEL = 47
# optical centre in the world
X, Y, Z = 48, 49, 50
WIDTH = 51

NO_LENS, BROWN, BROWN_TILTED, FISHEYE = 0, 1, 2, 3
