"""Methods that relocbench measures."""

from relocbench.kernel_cache import use_kernel_cache

use_kernel_cache()  # before any module with a kernel is loaded
