"""Closed-form solutions, each with its source, domain and accuracy; plain arrays in and out, no run and no dataset."""

from ..geometry.values import public
from .free_bodies import free_nontwisting, free_standard, symmetric_top
from .geometric_phases import latitude_turn, momentum_period, montgomery_angle, polygon_turn
from .gyrostats import free_gyrostat
from .nontwisting_body import (
    discrete_angle,
    discrete_free,
    discrete_second_quotient,
    loaded_momentum,
    loaded_nontwisting,
)
from .suslov_body import suslov, suslov_velocity

__all__ = [
    "discrete_angle",
    "discrete_free",
    "discrete_second_quotient",
    "free_gyrostat",
    "free_nontwisting",
    "free_standard",
    "latitude_turn",
    "loaded_momentum",
    "loaded_nontwisting",
    "momentum_period",
    "montgomery_angle",
    "polygon_turn",
    "suslov",
    "suslov_velocity",
    "symmetric_top",
]
public(__name__)
