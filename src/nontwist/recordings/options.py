"""What a user says of a recording that its file does not, and the sentences that he is told, by their codes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from ..errors import SENTENCES, InputError, Option
from ..spec import Spec, require_types

COLUMNS = Spec(
    "Headers of the columns to use: 4 of a quaternion or 9 of a matrix, row by row, or 3 with {option[euler]} or "
    "{option[rotation_vector=True]}; before them that of the time if there is one. Without headers, column numbers.",
    "A,B,...",
)
BODY = Spec(
    "Which of several to use: a segment, sensor, joint, topic, frame or array, a value of the column that names the "
    "sensor of each row, or the common beginning of the headers of a sensor.",
    "NAME",
)
SCALAR = Spec("Order of quaternions, w x y z or x y z w, as they are stored.", "", "--scalar-first/--scalar-last")
EULER = Spec("Axes of three angles, in the order of the columns: ZYX about moving axes, zyx about fixed axes.", "AXES")
ANGLE_UNIT = Spec("Unit of angles, if the file does not name it.", "deg|rad")
TIME_UNIT = Spec("Unit of the time column: s, ms, us, ns, min, h, day, or the seconds of one count.", "UNIT")
RATE = Spec(
    "Samples per second. Times are then computed from a column of sample or packet numbers, or else by counting rows; "
    "times in the file are ignored.",
    "HZ",
    unit="Hz",
)
NORMALIZE = Spec("Scale rounded or commonly scaled quaternions to length 1, and matrices to the nearest rotations.")
INVERSE = Spec(
    "Invert every attitude, for sensors that report the earth relative to the sensor. By default what a gyroscope or "
    "an accelerometer in the file decides, or else not.",
    option="--inverse/--no-inverse",
)


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """The options of `nontwist.read_motion`; None: what the recording states itself."""

    columns: Annotated[Sequence[str] | None, COLUMNS] = None
    time_column: Annotated[str | None, Spec("Header of the time column.", "NAME")] = None
    body: Annotated[str | None, BODY] = None
    scalar_first: Annotated[bool | None, SCALAR] = None
    euler: Annotated[str | None, EULER] = None
    rotation_vector: Annotated[bool, Spec("The columns are a rotation vector, axis times angle.")] = False
    angle_unit: Annotated[Literal["deg", "rad"] | None, ANGLE_UNIT] = None
    time_unit: Annotated[str | None, TIME_UNIT] = None
    rate: Annotated[float | None, RATE] = None
    normalize: Annotated[bool, NORMALIZE] = False
    inverse: Annotated[bool | None, INVERSE] = None

    def __post_init__(self) -> None:
        """Check the values."""
        require_types(self)
        if self.rate is not None and not 1e-9 <= self.rate <= 1e12:
            raise InputError("rate", rate=self.rate)
        if self.euler is not None and self.rotation_vector:
            raise InputError("option-without-effect", name=Option("rotation_vector"), why="three angles are read")
        if self.euler is not None:
            from ..geometry.attitudes import require_sequence

            require_sequence(self.euler)

    def require_without(self, name: str, why: str) -> None:
        """Refuse an option that has no effect."""
        if getattr(self, name) is not None:
            raise InputError("option-without-effect", name=Option(name), why=why)


def require_plain(options: Mapping[str, Any]) -> None:
    """Refuse options of files where arrays or a run are given; that these are in SI units may be said."""
    for name, value in options.items():
        if not (value is None or value is False or {"unit": "rad/s", "time_unit": "s"}.get(name) == value):
            why = "arrays and runs are in s and rad/s, and have no columns"
            raise InputError("option-without-effect", name=Option(name), why=why)


SHARED = "; {option[clocks='shared']} uses their times unchanged, if both come from one clock"
SHAKE = "; {option[shake=T0,T1]} names times when both were shaken together, with the joint at rest" + SHARED
NO_CLOCKS, ENOUGH = "the clocks cannot be aligned: ", "clocks are aligned from at least {least} samples; there are "
OR_COLUMNS = "; or name the columns to take: {option[columns]}"
SEVERAL = "more than one set of columns contains an orientation ({sets})"
TIMES = "2026-01-31T12:00:00.25; {option[time_column]} names another column, {option[rate=HZ]} counts rows"
NO_ORIENTATION = "no columns contain an orientation (qw qx qy qz, or r11 ... r33)"
OMIT = "; omit it, or rename the columns"
SENTENCES |= {
    # files
    "source": "source must be a path, a text stream or a DataFrame, got {value}",
    "no-content": "the file has no content (0 bytes); export the recording again",
    "packed": "it is {packed}: unpack it, and read the files inside",
    "json": "it is JSON: export the recording as CSV, with a header for each column",
    "skeleton": "it is AMC, whose angles are about axes that an ASF file defines: convert both to BVH",
    "trc": "it is TRC, positions of markers: the page on recordings makes attitudes of three",
    "unknown-format": "the suffix {suffix!r} is not known, and it is not a text file; export CSV, or one of {known}",
    "too-large": "it has {size:.3g} GB, and {free:.3g} GB of memory are free: cut it into parts",
    "long-stream": "the stream is longer than {size:g} MB; save it in a file",
    "file-changed": "it has changed while it was read; wait until it is complete, and read it again",
    "text-inside": "it is text, not a {suffix} file: if it holds columns, give it a name that ends in .csv",
    "not-text": "it is not a text file; the suffix determines the format: see the table of formats",
    "unreadable": "it is not a readable {what}: {why}",
    "same-name": "{name!r} is the name of two {kind}s: rename one of them in the file",
    # tables
    "empty": "the first line is empty; it must contain the headers of the columns",
    "comments-only": "the file has comments only; below them it must contain headers and rows",
    "records": "it is a log of records ({kinds}): copy the rows of one kind into a CSV file, with headers above",
    "empty-fields": "blanks do not show which of {headers} headers lack a field in a row of {fields}; use commas",
    "more-fields": "there are {headers} headers, but {fields} fields in a row of numbers",
    "fields": "{place} does not have the {count} fields of the first; correct or delete it",
    "segments": "{place} states {key} = {now}, another segment {was}: copy each segment into a file of its own",
    "row-length": "{place} of the {what} has {count} numbers instead of {width}",
    "no-headers": "it has no headers; of {count} columns name those to use, from 1: {option[columns]}",
    "no-column": "there is no column {name!r}; there are {names}",
    "no-columns": "it has no columns; {option[body]} names what to take",
    "not-a-number": "{what} holds {value!r} in {place}, which is not a number; correct or delete it",
    "thousands": "the marks in the column {name!r} look like those of thousands: write one decimal mark, and thousands "
    "without any",
    "columns": "name {sizes}, the time before them; got {count}",
    "three-columns": "3 columns need {option[euler]}, if they are angles, or {option[rotation_vector=True]}",
    # sensors and bodies
    "several-sensors": "the column {header!r} names the sensor of each row: {names}; {option[body]} takes one",
    "rows-in-turn": "the rows look like those of {count} sensors in turn, which no column names: they differ far more "
    "from their neighbours than from every {count}th row; copy those of each into a file of its own",
    "no-body": "there is no body {body!r}; {option[body]} takes {names}",
    "no-bodies": "the columns name no body; omit {option[body]}",
    "several-bodies": "more than one array or body contains an orientation; {option[body]} takes {names}",
    "several-orientations": SEVERAL + "; name the columns to take: {option[columns]}",
    "bodies-in-columns": SEVERAL + "; {option[body]} takes one of {bodies}" + OR_COLUMNS,
    "which-topic": "specify the topic: {option[body]} {names}",
    "which-instrument": "specify the instrument: {option[body]} {names}",
    # orientations
    "no-orientation": NO_ORIENTATION + ": {names}; name the columns to use: {option[columns]}, with {option[euler]} or "
    "{option[rotation_vector=True]} for angles",
    "gyroscope-alone": NO_ORIENTATION + ": {names}; {gyroscope} are of a gyroscope, which has no attitude: "
    "integrate it first, as AngularRate of the package ahrs does; fit_inertia and nontwist fit read it as it is"
    + OR_COLUMNS,
    "markers": NO_ORIENTATION + ", but {markers} look like markers: the page on recordings makes attitudes of three",
    "three-of-four": "the columns {three} are three of a quaternion, without {fourth!r}; export it" + OR_COLUMNS,
    "attitudes": "{name} is for columns; the file has attitudes ({names}): omit it, or name three: {option[columns]}",
    "no-attitudes": "it contains no array of attitudes and no columns; {help}",
    "no-messages": "no topic contains an orientation; there are {topics}",
    "scalar-unknown": "{who} not show the scalar; {option[scalar_first=True]} or {option[scalar_first=False]} does",
    "which-angles": "it is not clear which columns are {what}: {names}; name three in this order: {option[columns]}",
    "angles": "the columns {three} are angles: {option[euler]} gives their order, as ZYX about moving, zyx fixed axes",
    "angle-unit-stated": "the columns {three} state {stated}, but {option[angle_unit]} is {unit}" + OMIT,
    "no-angle-unit": "the columns {three} do not state the unit of their angles: {option[angle_unit]} is deg or rad",
    "angle-units": "the columns {three} state different units: convert one",
    "short-angles": "the columns {three} hold up to {longest:.4g} deg, and leap by 2π: if they are rad, "
    "{option[angle_unit]} is rad, or the header that states deg is to be corrected",
    "vector-of-quaternion": "the columns {three} are no longer than 1, and reverse there: they look like three of a "
    "quaternion, not like a rotation vector: compute the fourth from them, √(1 - x² - y² - z²)",
    "long-angles": "the columns {three} hold up to {longest:.4g} rad, more than a turn: if they are degrees, "
    "{option[angle_unit]} is deg, or the header that states rad is to be corrected",
    "several-readings": "several readings are possible ({readings}): state the one that is meant: "
    "{option[euler]}, {option[angle_unit]}, {option[scalar_first=True]} or {option[inverse=True]}",
    "no-reading-fits": "no reading of the attitudes agrees with the {what} beside them, {best:.2f} of 1 at best: check "
    "axes and units of both",
    "options-contradicted": "{told} {mine:.4f} as it is read, {best:.4f} as {another}: the options look wrong",
    "unlike-headers": "{words}: the file states another order, and nothing in the file confirms this one",
    "reading-by-evidence": "{told} {best:.2f} as {chosen}, {mine:.2f} as {stated}: the first is taken",
    "not-rotations": "the {what} are no rotations: {low:.6g} to {high:.6g} long, they look like positions or signals",
    "scaled": "no valid rotation in {rows}, the first is {place}: its {what} has the length {size:.6g}; they look "
    "{looks}: {option[normalize=True]} converts them to rotations",
    # formats
    "no-endheader": "no line 'endheader' ends its header; give a table without it a name that ends in .csv",
    "no-rows": "there is no row of numbers below its headers",
    "labels": "{place} has {count} fields, its labels are {labels}",
    "no-frames": "there is no frame with an orientation in it; export it with orientations of segments or sensors",
    "no-rotations": "it contains markers or signals, no rotations (group ROTATION); export these, or attitudes as CSV",
    "no-hierarchy": "it has no HIERARCHY followed by MOTION, as a BVH file has",
    "no-frame-time": "there is no line 'Frame Time:' below MOTION with a time above 0",
    "hierarchy": "its HIERARCHY is cut short or not one of a BVH file",
    "no-rate": "a C-kernel is a function of time: {option[rate=HZ]} gives samples per second",
    "no-samples": "there are no attitudes at this rate; choose a higher {option[rate]}",
    # times
    "rate": "{option[rate]} must be 1e-9 to 1e12 samples per second, got {rate:g}",
    "rate-and-time": "{option[rate]} ignores the times, but {name!r} is named as their column; leave out either",
    "several-times": "more than one column may be the time: {names}; {option[time_column]} names one",
    "time-unit": "unknown unit of time {unit!r} in the column {name!r}; {option[time_unit]} is {units} or s per count",
    "time-unit-stated": "the column {name!r} states {stated}, but {option[time_unit]} is {unit}" + OMIT,
    "no-time-unit": "the column {name!r} does not state its unit, with samples {step:g} apart; {option[time_unit]} is "
    "s, ms, us, ns, or the seconds of one count",
    "not-a-time": "the column {name!r} holds {value!r}, which is neither a number nor a time like " + TIMES,
    "day-or-month": "the column {name!r} holds {value!r}, where day and month cannot be distinguished: {why}; write "
    "dates like " + TIMES,
    "time-contradicted": "by the gyroscope, times are to be multiplied by {factor:.3g}: its unit or theirs is wrong",
    "turns-lost": "by the gyroscope the body turns by up to {most:.3g} turns from one attitude to the next, by more "
    "than half a turn in {steps}: whole turns are lost, and the twist is wrong; record attitudes at a higher rate",
    "time-length": "the time has {times} values, the orientation {count}",
    "time-shape": "{name} must have the shape ({count},) as the motion has {count} samples, got {shape}",
    "no-time": "it has no time column; {option[rate=HZ]} gives times, {option[time_column]} names one",
    "clock-goes-back": "the clock goes back by {back:.6g} s at {place}: read recordings that follow each other one by "
    "one; {option[rate=HZ]} counts rows where times are wrong",
    # samples
    "lost-samples": "the column {name!r} numbers {samples} that the file lacks, the first before {place}; "
    "{option[rate=HZ]} makes gaps of them",
    "missing-rows": "dropped {rows} with a zero or missing attitude or a missing time, the first is {place}",
    "unsorted-times": "times are not in order, the first at {place}; rows are sorted by time",
    "duplicate-times": "dropped {rows} with duplicate timestamps, the first is {place}",
    "rounded-times": "dropped {rows} with duplicate timestamps, the first is {place}: the times look rounded to "
    "{step:.3g} s, about {each:.2g} rows share each; {rate}, or the rate that you know, reads rows as evenly spaced; "
    "the error estimates do not include an error of the times of {half:.2g} s",
    "gaps": "{gaps} longer than {most:g} sampling intervals, the longest of {step:.4g} s from {first} to {last}: the "
    "motion in between is a guess",
    "too-few-samples": "{what} needs at least {least} samples; {left} of {count} are left{why}",
    # angular velocities
    "no-gyroscope": "no columns contain an angular velocity (gx gy gz, gyr_x gyr_y gyr_z, wx wy wz): {names}; name "
    "three: {option[columns]}; or fit attitudes: {option[orientation='only']}",
    "several-gyroscopes": "several sets of columns contain an angular velocity ({sets}); name three: {option[columns]}",
    "unit": "unknown unit of angular velocity {unit!r}; known are {units}",
    "unit-stated": "the columns {names} state {stated}, but {option[unit]} is {unit}" + OMIT,
    "no-unit": "the columns {names} do not state their unit: {option[unit]} is rad/s or deg/s{hint}",
    "no-speed-unit": "the column {names!r} does not state its unit: unit={units} among the settings of the rotor",
    "speed-unit": "unknown unit of speed {unit!r}: unit= among the settings of the rotor is one of {units}",
    "speed-unit-stated": "the column {names!r} states {stated}, but the rotor has unit={unit}" + OMIT,
    "no-speed": "a run has no column {speed!r}; give the speed of the rotor as a number, rad/s",
    "missing-rates": "dropped {rows} without finite numbers, or of zeros amid motion, the first is {place}",
    "fast": "angular velocities of up to {fastest:.4g} rad/s exceed those of common gyroscopes: is the unit right?",
    "lengths": "there are {attitudes} attitudes and {rates} angular velocities: both need the same times",
    # two recordings
    "static-alone": "{option[static]} requires {option[align='static']}",
    "one-sensor": "{name} is of two sensors: {option[relative_to]} names the second",
    "shake-of-one-clock": "{option[shake]} aligns two clocks: {option[clocks='shift']} or {option[clocks='drift']}",
    "sample-counts": "the second recording has {other} samples, the first {count}: both need times; "
    "{option[rate=HZ]} gives them when a file is read",
    "no-times": "clocks are aligned from times; both recordings need them: {option[rate=HZ]} when a file is read",
    "time-zones": "the dates of both files are {hours:g} hours apart, and overlap without: taken for two time zones",
    "clocks-differ": "by the angular speeds the clock of the second recording is to be shifted by {shift:+.4g} s "
    "(correlation {alike:.2f} without): {option[clocks='shift']} does, {option[clocks='shared']} takes the times as "
    "they are",
    "dates-apart": "by their dates the recordings begin {hours:.3g} hours apart, and their angular speeds do not align "
    "them: are they of one trial? {option[clocks='shift']} says what the speeds lack",
    "spaces-apart": "both sensors move as one if the second is turned by {angle:.3g}° in space (correlation {best:.3f},"
    " else {alike:.3f}): their headings differ, and the twist is wrong; reset both in one pose",
    "clocks-unlike": "the angular speeds correlate by {alike:.2f}: nothing shows that the times are of one clock; "
    "{option[clocks='shift']} looks for a shift, {option[clocks='shared']} takes the times as they are",
    "no-overlap": "the recordings do not overlap: {first:.6g} s to {last:.6g} s, and {other_first:.6g} s to "
    "{other_last:.6g} s; {option[clocks='shift']} finds how their clocks differ",
    "not-covered": "dropped {rows} at times that the second recording does not cover",
    "no-pose": "no sample is between {first:g} and {last:g}; they are from {start:.6g} to {end:.6g}",
    "pose-moves": "the sensors are not at rest in the static pose; {option[static=T0,T1]} says where another is",
    "few-to-align": ENOUGH + "{count} and {other}" + SHARED,
    "few-shaken": ENOUGH + "{count} in {option[shake]}, of {first:.6g} s to {last:.6g} s, and {other} in the second",
    "long-recordings": NO_CLOCKS + "in {length:.6g} s and {other:.6g} s steps are {step:.3g} s, and {count} of them "
    "hold the motion; cut off what lies far from it",
    "steady-speeds": NO_CLOCKS + "a sensor rests or turns at one speed all the time; shake both together" + SHARED,
    "unlike-speeds": NO_CLOCKS + "the speeds correlate by {correlation:.2f} at best, {least:g} is required" + SHAKE,
    "relative-motion": NO_CLOCKS + "by the best shift, {shift:+.4g} s, they turn most against each other" + SHAKE,
    "several-shifts": NO_CLOCKS + "the motion repeats: another shift, {apart:+.4g} s from the best one, fits nearly as "
    "well (correlation {other:.3f} against {best:.3f})" + SHAKE,
    "uncertain-drift": "the speeds leave the drift of the clocks uncertain by {ppm:.2g} ppm; shake both sensors "
    "together at the start and at the end, or use {option[clocks='shift']}",
    # loads in tables
    "table-columns": "it has {found} columns ({names}); {choice}",
    "table-changed": "it has changed: its SHA-256 is {sha256}",
    "table-large": "it is larger than {size:g} MB",
    "table-headers": "its first line must contain the headers of the columns",
    "table-unit": "the column {name!r} states {unit}; times are in s{words}: convert it",
    "table-cell": "the column {name!r} {holds} in {place}",
}
