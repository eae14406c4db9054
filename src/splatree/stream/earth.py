"""Where on the earth a scene stands: the frame east, north, up at a point of the ellipsoid WGS 84."""

import numpy as np

from splatree.errors import InputError
from splatree.shapes import Array, Float64

__all__ = ["ecef_from_enu"]

_RADIUS_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563
"""WGS 84: half the equator's diameter, and by how much of it the poles are nearer (NIMA TR8350.2)."""


def ecef_from_enu(latitude_deg: float, longitude_deg: float, height_m: float) -> Float64[Array, "4 4"]:
    """The rigid transform from east, north, up at a point to earth-centred, earth-fixed coordinates, metres.

    Raises:
        InputError: the point is not on the earth.
    """
    if not (-90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180 and abs(height_m) <= 1e6):
        raise InputError(
            f"origin: found {latitude_deg}, {longitude_deg}, {height_m}, wanted latitude −90 to 90 and longitude −180 to 180 "
            "degrees, and a height in metres"
        )
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    squared_eccentricity = _FLATTENING * (2 - _FLATTENING)
    to_axis = _RADIUS_M / np.sqrt(1 - squared_eccentricity * np.sin(latitude) ** 2)
    east = np.array([-np.sin(longitude), np.cos(longitude), 0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    place = np.array([to_axis, to_axis, to_axis * (1 - squared_eccentricity)]) * up + height_m * up
    matrix = np.eye(4)
    matrix[:3] = np.stack([east, np.cross(up, east), up, place], axis=1)
    return matrix
