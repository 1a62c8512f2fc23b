"""Place recognition by networks whose weights their authors publish or the user gives."""

from baselines.place_networks.retrievers import CosPlace, EigenPlaces, MegaLoc, NetVlad

__all__ = ["CosPlace", "EigenPlaces", "MegaLoc", "NetVlad"]
