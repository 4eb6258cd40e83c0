"""What each process of a fault is forked from: all is imported, and the machine code of a run is there."""

import sys

import h5netcdf  # noqa: F401
import pandas  # noqa: F401
import scipy.linalg  # noqa: F401

from . import FAULTS  # noqa: F401
from .files import a_run

a_run()
sys.dont_write_bytecode = True  # Python itself would leave half a file of bytecode on a full disk, for all who follow
