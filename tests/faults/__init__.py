"""What can go wrong around a run, made to happen; run by tests/pages/test_faults.py and by `make faults`.

A fault is a function of an empty folder. Its docstring says what is done; it raises AssertionError where the package
does not behave, and returns what happened, in words.
"""

from . import files, processes, systems, writers

MODULES = (files, processes, systems, writers)

FAULTS = {fault.__name__: fault for module in MODULES for fault in module.FAULTS}
LONG = {fault.__name__ for module in MODULES for fault in module.LONG}
