"""Command lines with impossible values; the first one is valid. FOLDER is a small session of OpenPose JSON."""

_TRACK = "track FOLDER --out FOLDER/../out"
_CLOCKS = "calibrate clocks FOLDER"
_BOARD = "calibrate print --target charuco --rows 5 --marker-mm 20 --out FOLDER/a.pdf"
_MARKERS = "calibrate print --target markers --out FOLDER/a.pdf"
_PEOPLE = "cam00=FOLDER/pose2d/cam00_json cam01=FOLDER/pose2d/cam01_json"
_PERSON = f"calibrate person {_PEOPLE} --intrinsics FOLDER/rig.toml --out FOLDER/r.toml"
_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "1e9", "-1", "0")
_SETTINGS = (
    "rate_hz=1e9", "rate_hz=nan", "rate_hz=1e-300", "rate_hz=0", "cameras.cam00.offset_s=1e12", "cameras.cam00.offset_s=nan",
    "cameras.cam00.drift_ppm=1e9", "cameras.cam00.crop=[nan, 0]", "associate.max_people=0", "associate.max_people=-3",
    "associate.near_xy_m=[nan, 0]", "fuse.sigma_share=inf", "fuse.score_min=-1", "smooth.speed=nan",
    "outputs=[1]", "outputs=['none']", "detector=5", "detector.options.x=1", "input='films'", "cameras=5", "rig=5", "a.b.c=1",
)  # fmt: skip

OPTIONS: tuple[str, ...] = (
    _TRACK,
    *(f"{_TRACK} {option}={value}" for option in ("--start", "--end") for value in _NUMBERS),
    *(f"{_TRACK} --person={value},{value}" for value in _NUMBERS),
    *(f'{_TRACK} --set "{setting}"' for setting in _SETTINGS),
    f"{_TRACK} --outputs ,",
    f"{_TRACK} --rig nowhere.toml",
    f"{_TRACK} --config FOLDER",
    "compare FOLDER FOLDER",
    "compare FOLDER/rig.toml FOLDER/rig.toml",
    *(f"compare FOLDER/a.trc FOLDER/b.trc --align-first={value}" for value in _NUMBERS),
    *(f"simulate FOLDER/none.yaml --out FOLDER/s --workers={value}" for value in ("0", "-1", "nan")),
    *(f"{_CLOCKS} --{option}={value}" for option in ("rate", "rate 30 --seconds", "rate 30 --most-s") for value in _NUMBERS),
    *(f"{_BOARD} --columns {value} --square-mm 30" for value in ("0", "-1", "1000000")),
    *(f"{_BOARD} --columns 5 --square-mm={value}" for value in _NUMBERS),
    *(f"{_MARKERS} --marker-mm={value} --ids 1" for value in _NUMBERS),
    f"{_MARKERS} --marker-mm 50 --ids -1",
    f"{_MARKERS} --marker-mm 50 --ids 1 --dictionary DICT",
    *(f"{_PERSON} --rate={value} --height-m 1.8" for value in _NUMBERS),
    *(f"{_PERSON} --rate 30 --height-m={value}" for value in _NUMBERS),
    *(f"calibrate verify cam00=FOLDER --rig FOLDER/rig.toml --target FOLDER/board.toml --every={value}" for value in (0, -2)),
)
