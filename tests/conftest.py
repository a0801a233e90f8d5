"""Properties are tried with new examples on every developer's run, and with the same ones in continuous integration."""

import os

from hypothesis import settings

settings.register_profile("developer", deadline=None)
settings.register_profile("integration", deadline=None, derandomize=True)
settings.load_profile("integration" if os.environ.get("CI") else "developer")
