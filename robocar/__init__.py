"""Mobile-robot navigation in MuJoCo physics without ROS.

The stable API: `robocar.run(scenario, navigator=..., estimator=..., seed=..., out=None)` returns a `RunResult`;
`robocar.simulate(scenario)` gives the physics alone. Both are imported when first used, so that `import robocar` stays light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robocar.episode.run import RunResult, run, simulate

__version__ = "0.1.0"
__all__ = ["RunResult", "__version__", "run", "simulate"]


def __getattr__(name: str) -> Any:
    if name not in ("RunResult", "run", "simulate"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # The module `robocar.run` becomes an attribute of the package when imported; the function of that name takes its place.
    module = import_module("robocar.episode.run")
    globals().update(run=module.run, simulate=module.simulate, RunResult=module.RunResult)
    return globals()[name]
