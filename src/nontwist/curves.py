"""Curves: frames along them that do not twist, their holonomy, and the link, twist and writhe of ribbons."""

from .analysis.curve_reports import curve_report
from .geometry.curves import frame_along, frame_of_curve
from .geometry.frames import closed_frame, frame_error_estimate, holonomy, nontwisting_frame, solid_angle
from .geometry.linking import link, ribbon_twist, writhe

__all__ = [
    "closed_frame",
    "curve_report",
    "frame_along",
    "frame_error_estimate",
    "frame_of_curve",
    "holonomy",
    "link",
    "nontwisting_frame",
    "ribbon_twist",
    "solid_angle",
    "writhe",
]
