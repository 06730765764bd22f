# MuJoCo's classes live in compiled modules without stubs, in which pyright finds nothing. So that everything else of ours is
# checked, what is MuJoCo's counts as Any. To be removed when the wheel brings its stubs.
from typing import Any

def __getattr__(name: str) -> Any: ...
