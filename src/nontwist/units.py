"""Units that files and options state: their spellings, and their factors to SI units."""

from __future__ import annotations

import math
import re

DEGREE = math.pi / 180
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
ANGLE = {"rad": 1.0, "deg": DEGREE}
RATE = {"rad/s": 1.0, "deg/s": DEGREE, "mdeg/s": math.pi / 180e3, "mrad/s": 1e-3, "rpm": math.pi / 30}
MOMENT = {"Nm": 1.0, "mNm": 1e-3, "µNm": 1e-6, "kNm": 1e3, "MNm": 1e6, "Nmm": 1e-3, "Ncm": 1e-2}
MOMENT |= {"mNmm": 1e-6, "mNcm": 1e-5, "kNmm": 1.0, "lbfft": 1.3558179, "lbfin": 0.11298483, "ozfin": 7.0615518e-3}
MOMENT |= {"kgfm": 9.80665, "kgfcm": 0.0980665, "gfcm": 9.80665e-5}
MOMENTUM = {"Nms": 1.0, "kgm2/s": 1.0, "mNms": 1e-3, "µNms": 1e-6}
OTHER = "no_units|nounits|n/a|-|g|m/s2|ut|mt|degc|°c|kpa|hpa|pa|m|mm|"  # of columns that are not read
SPELLED = (
    (r"^in\s+(?!lb|oz)", ""), (r"[\s·⋅*.^()_\[\]]", ""), ("º", "°"), ("⁻¹", "-1"), ("²", "2"), ("−", "-"), ("μ", "µ"),
    (r"degrees?|°", "deg"), (r"radians?", "rad"), (r"(?<!m)(?<!u)(?<!n)sec(?:onds?|s)?$", "s"), ("per", "/"),
    (r"milli(?:s(?:ec(?:onds?)?)?)?$|msecs?$", "ms"), (r"micro(?:s(?:ec(?:onds?)?)?)?$|usecs?$", "us"),
    (r"nano(?:s(?:ec(?:onds?)?)?)?$|nsecs?$", "ns"), ("minutes?$", "min"), ("hours?$", "h"), ("days$", "day"),
    ("^(m?)dps$", r"\1deg/s"), ("^u/min$|^1/min$", "rpm"), (r"^(m?(?:deg|rad))(?:p|/)?s(?:ec)?(?:-1)?$", r"\1/s"),
    (r"(?<=[a-z])-(?=[a-z])", ""), (r"^(ft|in)(lb|oz)f?$", r"\2f\1"), (r"^(lb|oz)(?=ft|in)", r"\1f"), ("^kpm", "kgfm"),
    ("m2s-1", "m2/s"), (r"\*\*|\^", ""),
)  # fmt: skip


def known(text: str | None, units: dict[str, float]) -> str | None:
    """Return the key of `units`, one of the tables above, that a spelling means; None where it is none."""
    if text is None or not text.strip():
        return None
    word = text.strip()
    if units is not MOMENT and units is not MOMENTUM:  # mN m and MN m differ
        word = word.lower()
    for pattern, instead in SPELLED:
        word = re.sub(pattern, instead, word)
    return word if word in units else None


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any column of a recording."""
    tables = (TIME, ANGLE, RATE, MOMENT, MOMENTUM)
    return any(known(text, one) for one in tables) or re.sub(r"[\s^()]", "", text.lower()) in OTHER.split("|")


def split_unit(header: str) -> tuple[str, str | None]:
    """Return the name of a column and the unit in brackets at its end, also ``(deg).1``; none are ``[1]``, ``(w)``."""
    match = re.match(
        r"^(.*?)\s*[\[(]\s*(?![wxyzWXYZ]\s*[\])])((?=[^\[\]]*[^\d\s\[\]()])[^\[\]]*?)[\])]\s*(\.\d+)?$", header.strip()
    )
    return (match[1], match[2].strip()) if match else (header.strip(), None)


def in_datasets(unit: str) -> str:
    """Return a unit as datasets write it: "kg m2 s-1" for "kg m²/s"."""
    plain = unit.translate(str.maketrans("²³⁻¹", "23-1"))
    return re.sub(r"/([a-zA-Zµ]+)(\d?)", lambda m: f" {m[1]}-{m[2] or 1}", plain)
