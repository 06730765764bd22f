"""No deadlines for hypothesis: the first example of a numba function may pay for its compilation."""

from hypothesis import settings

settings.register_profile("no-deadline", deadline=None)
settings.load_profile("no-deadline")
