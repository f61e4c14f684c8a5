"""Resampling of the wall and refraction at it, against closed forms and an independent ray tracer."""

from math import asin, radians, sin, tan

import numpy as np
import pytest
from scipy.optimize import brentq

from taichi_eye.film import Surface

THICKNESS, ANGLE, INDEX = 0.55, radians(45.0), 1.376


@pytest.fixture(scope="module")
def eye(synthetic_eye):
    eye = synthetic_eye()
    eye.surface = Surface(eye.scene)
    return eye


def updated(eye, height_mm):
    eye.set_wall(height_mm)
    eye.surface.update(eye.state.wall, eye.state.wall_count)
    return eye.surface


def apparent_thickness(eye, height_mm, x):
    surface = updated(eye, height_mm)
    radii = np.arange(surface.columns) * surface.spacing * 1e3
    height = surface.height.to_numpy()[: surface.columns]
    return np.interp(x, radii, (height - surface.apparent.to_numpy()[: surface.columns]) * 1e3)


def traced_thickness(radius, x):
    """Apparent thickness in column x under a sphere about the origin (its far side up for a negative
    radius), by a ray tracer on the exact spheres: the posterior surface is one of radius - thickness."""
    sign = np.sign(radius)

    def ray(y):
        entry = np.array([x, y, sign * np.sqrt(radius**2 - x**2 - y**2)])
        normal = entry / radius
        air = -np.array([0.0, np.sin(ANGLE), np.cos(ANGLE)])
        facing = -normal @ air
        bent = air / INDEX + (facing / INDEX - np.sqrt(1.0 - (1.0 - facing**2) / INDEX**2)) * normal
        hit = entry - entry[1] / bent[1] * bent
        return np.linalg.norm(hit) - abs(radius - THICKNESS), entry[2] - y / np.tan(ANGLE)

    entry = brentq(lambda y: ray(y)[0], 0.0, 2.0, xtol=1e-13)
    return sign * np.sqrt(radius**2 - x**2) - ray(entry)[1]


def test_flat_surface_shortens_by_the_closed_ratio(eye):
    ratio = apparent_thickness(eye, lambda r: 1.0 + 0.0 * r, 0.0) / THICKNESS
    assert ratio == pytest.approx(tan(asin(sin(ANGLE) / INDEX)) / tan(ANGLE), rel=1e-5)
    assert ratio == pytest.approx(0.599, abs=5e-4)


@pytest.mark.parametrize("radius, ratio", [(7.8, 0.627), (-7.0, 0.569)])
def test_curved_surface_shortens_by_the_published_ratio(eye, radius, ratio):
    assert apparent_thickness(eye, eye.sphere(radius), 0.0) / THICKNESS == pytest.approx(ratio, abs=1e-3)


@pytest.mark.parametrize("radius", [7.8, -7.0])
@pytest.mark.parametrize("x", [0.0, 1.5, 3.0, 4.4])
def test_refraction_agrees_with_rays_through_exact_spheres(eye, radius, x):
    found = apparent_thickness(eye, eye.sphere(radius), x)
    assert found == pytest.approx(traced_thickness(radius, x), abs=1.5e-4)


@pytest.mark.parametrize("depth", [0.0, 1.0])
def test_table_follows_the_wall_to_a_hundredth_of_a_pixel(eye, depth):
    profile = eye.dented(depth)
    surface = updated(eye, profile)
    radii = np.arange(surface.count) * surface.spacing * 1e3
    inside = radii < eye.limbus
    error_mm = surface.height.to_numpy()[: surface.count][inside] * 1e3 - profile(radii[inside])
    assert np.abs(error_mm).max() < 0.01 * eye.scene.camera.pixel_y_mm
    step = 1e-5
    slope = (profile(radii[inside] + step) - profile(np.abs(radii[inside] - step))) / (2.0 * step)
    slope[0] = 0.0
    assert np.abs(surface.slope.to_numpy()[: surface.count][inside] - slope).max() < 3e-3


def test_surface_goes_on_straight_beyond_the_limbus(eye):
    surface = updated(eye, eye.sphere())
    radii = np.arange(surface.count) * surface.spacing * 1e3
    outside = radii > eye.limbus
    assert outside.sum() > 10
    slope = -eye.limbus / np.sqrt(eye.radius**2 - eye.limbus**2)
    height = surface.height.to_numpy()[: surface.count][outside] * 1e3
    assert np.allclose(height, slope * (radii[outside] - eye.limbus), atol=1e-6)
