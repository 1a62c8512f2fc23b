"""relocbench: relocalization tracking measured across weather, light and season."""

__version__ = "0.1.0"
