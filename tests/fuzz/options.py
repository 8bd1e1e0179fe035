"""Command lines with impossible values; the first one is valid. FOLDER is a small session of OpenPose JSON."""

_TRACK = "track FOLDER --out FOLDER/../out"
_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "-1", "0")
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
    *(f"calibrate clocks FOLDER --seconds={value} --rate 30" for value in _NUMBERS),
    *(f"calibrate clocks FOLDER --rate={value}" for value in (*_NUMBERS, "1e9")),
    *(f"calibrate clocks FOLDER --most-s={value} --rate 30" for value in _NUMBERS),
    *(
        f"calibrate print --target charuco --columns {value} --rows 5 --square-mm 30 --marker-mm 20 --out FOLDER/a.pdf"
        for value in ("0", "-1", "1000000")
    ),
    *(
        f"calibrate print --target charuco --columns 5 --rows 5 --square-mm={value} --marker-mm 20 --out FOLDER/a.pdf"
        for value in _NUMBERS
    ),
    *(f"calibrate print --target markers --marker-mm={value} --ids 1 --out FOLDER/a.pdf" for value in _NUMBERS),
    "calibrate print --target markers --marker-mm 50 --ids -1 --out FOLDER/a.pdf",
    "calibrate print --target markers --marker-mm 50 --ids 1 --dictionary DICT --out FOLDER/a.pdf",
    *(
        f"calibrate person cam00=FOLDER/pose2d/cam00_json cam01=FOLDER/pose2d/cam01_json --intrinsics FOLDER/rig.toml "
        f"--rate={value} --height-m 1.8 --out FOLDER/r.toml"
        for value in (*_NUMBERS, "1e9")
    ),
    *(
        f"calibrate person cam00=FOLDER/pose2d/cam00_json cam01=FOLDER/pose2d/cam01_json --intrinsics FOLDER/rig.toml "
        f"--rate 30 --height-m={value} --out FOLDER/r.toml"
        for value in _NUMBERS
    ),
    "calibrate verify cam00=FOLDER --rig FOLDER/rig.toml --target FOLDER/board.toml --every=0",
    "calibrate verify cam00=FOLDER --rig FOLDER/rig.toml --target FOLDER/board.toml --every=-2",
)
