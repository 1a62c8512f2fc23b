"""relocbench: relocalization tracking measured across weather, light and season."""

from relocbench.kernel_cache import use_kernel_cache

__version__ = "0.1.0"

use_kernel_cache()  # before any module with a kernel is loaded
