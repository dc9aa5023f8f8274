"""The paper's world: dynamics, channel, packets, safety and energy (Sec. IV-A).

Written from the paper and from docs/choices.md, which holds the values that the paper omits. It shares no
code with the Rust programs. Vectors are arrays of shape [..., 2], in units of the paper's square; speeds
are in units per control interval. All functions broadcast over the leading axes.
"""

from dataclasses import dataclass, replace

import numpy as np


def _point(x, y):
    return np.array([x, y], dtype=float)


@dataclass(frozen=True)
class World:
    """Every parameter of a flight; the defaults are Scenario 2 (docs/choices.md, section 1)."""

    horizon: int = 100
    start: tuple = (0.1, 0.5)
    goal: tuple = (0.9, 0.5)
    goal_radius: float = 0.05
    base_station: tuple = (0.5, 0.05)
    obstacle: tuple = (0.50, 0.45)
    obstacle_radius: float = 0.10
    uav_radius: float = 0.02
    v_max: float = 0.04
    a_max: float = 0.0035
    walls: bool = True
    reference_gain: float = 1.0
    path_loss_exponent: float = 2.0
    nlos_attenuation: float = 0.1
    noise_power: float = 1.0
    blockage_softness: float = 0.02
    distance_floor: float = 0.001
    snr_min: float = 1.0
    packet_bits: float = 4.0
    d_min: float = 0.0
    collision_softness: float = 0.02
    collision_tolerance: float = 0.05
    outage_tolerance: float = 0.05
    blade_profile_power: float = 79.0
    induced_power: float = 88.0
    tip_speed: float = 120.0
    hover_induced_velocity: float = 4.0
    fuselage_drag_ratio: float = 0.3
    air_density: float = 1.225
    rotor_solidity: float = 0.05
    rotor_area: float = 0.5
    metres_per_unit: float = 500.0
    interval_s: float = 0.4


OBSTACLES = {"S1": (0.50, 0.30), "S2": (0.50, 0.45)}
"""The obstacle of Scenarios 1 and 2 (Sec. IV-C)."""

POWERS = (1.0, 4.0)
"""A_p (Sec. IV-A1)."""


def scenario(name):
    """Scenario "S1" or "S2" of Sec. IV-C."""
    return replace(World(), obstacle=OBSTACLES[name])


def norm(x):
    """Euclidean length of vectors [..., 2]."""
    return np.sqrt(np.sum(np.square(x), axis=-1))


def sigmoid(x):
    """1 / (1 + e^-x), without overflow."""
    small = np.exp(-np.abs(x))
    return np.where(np.asarray(x) >= 0, 1.0, small) / (1.0 + small)


def limit(v, longest):
    """v, shortened to `longest` if it is longer: "the speed is limited" (Sec. IV-A1)."""
    length = norm(v)[..., None]
    return v * np.minimum(1.0, longest / np.maximum(length, 1e-300))


def step(r, v, action, gust, world):
    """Eq. (30): position and speed after an interval. `gust` is a change of speed, sigma_c w_k.

    The speed is limited before the position is updated (Sec. IV-A1; row "integrator" of docs/choices.md).
    A coordinate that leaves [0, 1] is clipped and its outward speed is zero (row `dynamics.walls`).
    """
    v = limit(v + world.a_max * np.asarray(action) + gust, world.v_max)
    r = r + v
    if not world.walls:
        return r, v
    v = np.where(r < 0.0, np.maximum(v, 0.0), np.where(r > 1.0, np.minimum(v, 0.0), v))
    return np.clip(r, 0.0, 1.0), v


def sight_gain(r, world):
    """|h_LOS|^2 = G0 d^-alpha_PL (Sec. IV-A3), d not below the row `channel.distance_floor`."""
    d = np.maximum(norm(r - _point(*world.base_station)), world.distance_floor)
    return world.reference_gain * d**-world.path_loss_exponent


def sight_line_distance(r, world):
    """Distance of the obstacle's centre to the segment from the base station to r (row "blockage")."""
    base = _point(*world.base_station)
    along, to = r - base, _point(*world.obstacle) - base
    squared = np.maximum(np.sum(along * along, axis=-1), 1e-12)
    t = np.clip(np.sum(along * to, axis=-1) / squared, 0.0, 1.0)
    return norm(to - t[..., None] * along)


def blockage(r, world):
    """p_k = sigmoid((R_o - d) / tau_b): the smooth obstruction of Sec. IV-A3, row "blockage"."""
    return sigmoid((world.obstacle_radius - sight_line_distance(r, world)) / world.blockage_softness)


def gain(r, world):
    """|h_k|^2 = (1 - p_k) |h_LOS|^2 + p_k kappa_NLOS |h_LOS|^2 (Sec. IV-A3)."""
    p = blockage(r, world)
    return ((1.0 - p) + p * world.nlos_attenuation) * sight_gain(r, world)


def snr(r, power, world):
    """Eq. (12): gamma_k = |h_k|^2 a_p / P_n."""
    return gain(r, world) * power / world.noise_power


def bits(b_dt, gamma):
    """R_k dt = B dt log2(1 + gamma_k): what an interval carries (Sec. IV-A4)."""
    return b_dt * np.log2(1.0 + gamma)


def outage(b_dt, gamma, world):
    """R_k dt < L_pkt, strictly (Sec. IV-A4)."""
    return bits(b_dt, gamma) < world.packet_bits


def outage_snr(b_dt, world):
    """The SNR at which an interval just carries the packet: 2^(L_pkt / (B dt)) - 1."""
    return 2.0 ** (world.packet_bits / b_dt) - 1.0


def clearance(r, world):
    """d(Omega_c, Omega_u): distance between the edges of UAV and obstacle (Eq. (21))."""
    between = norm(r - _point(*world.obstacle))
    return between - world.obstacle_radius - world.uav_radius


def collision_probability(r, world):
    """Ground truth: sigmoid((d_min - clearance) / tau_c) (row "ground-truth p_coll")."""
    return sigmoid((world.d_min - clearance(r, world)) / world.collision_softness)


def propulsion_power(v_mps, world):
    """P(V) in W of the rotary-wing model of Sec. IV-A6, V in m/s.

    Profile, induced and parasite power. sqrt(1 + x^2) - x is written as 1 / (sqrt(1 + x^2) + x), which
    does not cancel at high speed; x = V^2 / (2 v0^2).
    """
    v2 = np.square(v_mps)
    x = v2 / (2.0 * world.hover_induced_velocity**2)
    profile = world.blade_profile_power * (1.0 + 3.0 * v2 / world.tip_speed**2)
    induced = world.induced_power / np.sqrt(np.sqrt(1.0 + x * x) + x)
    drag = world.fuselage_drag_ratio * world.air_density * world.rotor_solidity * world.rotor_area
    return profile + induced + 0.5 * drag * v2 * v_mps


def metres_per_second(speed, world):
    """A speed in units per interval as m/s (rows `scale.metres_per_unit`, `scale.interval_s`)."""
    return speed * world.metres_per_unit / world.interval_s
