"""How the DeepLabCut file next to this script was made, as DeepLabCut makes it; needs pandas, tests do not."""

from pathlib import Path

import numpy as np
import pandas as pd

HERE = Path(__file__).parent
PARTS = ["nose", "LeftShoulder", "RightShoulder", "left_knee"]
LEVELS = {"scorer": ["net"], "individuals": ["one", "two"], "bodyparts": PARTS, "coords": ["x", "y", "likelihood"]}

columns = pd.MultiIndex.from_product(list(LEVELS.values()), names=list(LEVELS))
values = np.random.default_rng(0).uniform(0, 400, (3, len(columns))).round(2)
values[:, 2::3] = (values[:, 2::3] / 400).round(3)
values[1, 12:] = np.nan
table = pd.DataFrame(values, columns=columns)
table.to_csv(HERE / "deeplabcut_two.csv")
