"""Recordings: from a file to attitudes, rates, times and bodies, and the twist of a motion."""

from . import sentences as sentences  # which errors of this package look up
