"""Is a camera in focus?"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core.arrays import Array

# blurring by one pixel takes most of the fine detail of a sharp image, and little of one that is blurred already
_BLUR_PX = 1.0
# share of the Laplacian's energy that such a blur leaves; `python bench/studio.py focus` measures it for known blurs
_MOST_LEFT = 0.35
# parts of an image without edges carry no information
_LEAST_EDGE_DN = 12.0


def detail_left(image: Array) -> float:
    """Share of the fine detail of an RGB image (H, W, 3) that a blur of a pixel leaves at its strongest edges; else NaN."""
    raw = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    # noise of single pixels is no detail
    grey: Array = cv2.GaussianBlur(raw, (0, 0), 0.5)
    slope = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.25), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.25))
    limit = max(float(np.quantile(slope[::2, ::2], 0.99)), _LEAST_EDGE_DN)
    edges = slope >= limit
    if edges.sum() < 50:
        return float("nan")
    fine = cv2.Laplacian(grey, cv2.CV_32F)
    coarse = cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), _BLUR_PX), cv2.CV_32F)
    return float((coarse[edges] ** 2).sum() / max((fine[edges] ** 2).sum(), 1e-9))


def focus_warning(image: Array) -> str:
    """Advice where an image seems out of focus; empty where it does not, or has too little texture to judge."""
    left = detail_left(image)
    if left > _MOST_LEFT:
        return f"perhaps out of focus: its edges are {left:.0%} as sharp after a blur of {_BLUR_PX:g} px; turn the focus ring"
    return ""
