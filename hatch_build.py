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
        """Make the bitcode, which lies beside the sources; the target's `artifacts` take it along."""
        path = os.pathsep.join(filter(None, [os.path.join(self.root, "src"), os.environ.get("PYTHONPATH")]))
        command = [sys.executable, "-m", "nontwist.bitcode"]
        subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": path})
