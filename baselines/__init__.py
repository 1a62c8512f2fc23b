"""Methods that relocbench measures."""

from relocbench.kernels import use_kernel_cache

use_kernel_cache()  # before any module with a kernel is loaded
