"""What building a wheel, or an editable install, does beside copying: it compiles the kernels to bitcode."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface):
    """Run ``python -m nontwist.bitcode`` in the environment of the build."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make the bitcode, which lies beside the sources; the target's `artifacts` take it along.

        It runs where the sources are: pip takes the folders of an editable install that is there already off the path.
        """
        subprocess.run([sys.executable, "-m", "nontwist.bitcode"], check=True, cwd=os.path.join(self.root, "src"))
