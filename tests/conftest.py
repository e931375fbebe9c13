"""For all tests."""

import envs  # noqa: F401 (before PyTorch, as in the scripts: matrix products are computed as there)
