"""Settings of the controllers. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, Lt, NonNegative, Positive, RadS, Unit

Gains3 = tuple[NonNegative, NonNegative, NonNegative]  # per body axis
TorqueLimit = Annotated[float, Unit("N m"), Gt(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakingProfileConfig:
    """Sliding surface along a braking profile, s = w - w_d(theta); its margin adapts to what the wheels give.

    Made for a wheel health that tells it what they give, as `wheel_health: share_learner` does.
    """

    kind: Literal["braking_profile"]
    eta: Annotated[float, Gt(0), Le(1)] = 0.94  # share of the braking authority planned on, close to the target [1]
    k_theta: Positive = 1.0  # slope of the profile at the target [1/s]
    k_s: Positive = 0.65  # gain from the surface to acceleration [1/s]
    adapt: bool = True  # False: braking_share and eta throughout, whatever the wheels give
    braking_share: Annotated[float, Gt(0), Le(1)] = 0.4  # of each wheel's torque, planned on where adapt is off [1]
    # share planned on far from the target while all wheels are whole: there a fault costs most [1]
    eta_far: Annotated[float, Gt(0), Le(1)] = 0.11
    far_rad: Positive = 0.18  # distance over which eta passes to eta_far
    reserve: Annotated[float, Ge(0), Le(1)] = 0.05  # weight of "one more wheel fails" in the braking authority [1]
    # part of the way from eta_far to eta that the loss of one whole wheel takes: what has failed will not fail again [1]
    spent: NonNegative = 0.24


@dataclass(frozen=True, slots=True, kw_only=True)
class DismcConfig:
    """Discrete integral sliding mode with an estimate of the disturbance, after CN103699131B: docs/dismc.md.

    Made for `allocator: direct`, and for no observer: it estimates what acts on the body itself.
    """

    kind: Literal["dismc"]
    frequency_rad_s: Annotated[RadS, Gt(0)] = 0.1  # of the motion that is aimed at
    damping: Positive = 0.9  # of that motion [1]
    kappa: Annotated[float, Gt(0), Le(1)] = 0.3  # share of the surface that is taken back in a sample; the patent: 1
    lam: Annotated[float, Gt(0), Le(1)] = 0.3  # weight of the newest disturbance, per sample; the patent: 1
    c_1_s: NonNegative | None = None  # weight of the angle in the surface [1/s]; none: no offset from a gyro's bias
    latency: Annotated[int, Ge(0), Le(5)] = 0  # samples that pass until a command acts
    anti_windup: bool = True  # leave out of the surface what the wheels could not give
    torque_ratio: tuple[Positive, Positive] = (0.5, 2.0)  # true over assumed torque for which the loop must be stable
    stability: Literal["refuse", "warn"] = "refuse"  # where it is not: do not start, or say so and fly


@dataclass(frozen=True, slots=True, kw_only=True)
class FiniteTimeConfig:
    """PD with powers below one on modified Rodrigues parameters: zero error after finite time. Li & Liu 2011, law (14).

    Defaults are for 0.1 N m wheels and about 45 kg m^2. docs/finite-time.md says when to take it.
    """

    kind: Literal["finite_time"]
    form: Literal["A", "B", "C"] = "A"  # A: the paper's; B, C: finite time is proven from everywhere
    alpha1: Annotated[float, Gt(0), Le(1)] = (
        0.5  # power of the attitude; of the rate 2 alpha1/(1 + alpha1); 1: a PD law
    )
    k1: Positive = 1.0  # gain of the attitude [N m]
    k2: Positive = 4.0  # gain of the rate [N m (s/rad)^alpha2]
    sampling: Literal["explicit", "implicit"] = "explicit"  # implicit, form A alone: no limit cycle of the samples
    gyroscopic: bool = (
        False  # make up for w x J w too: theorem 2, for targets that turn; not where model.wheel_momentum is
    )
    latency: Annotated[int, Ge(0), Le(5)] = 0  # control periods until a torque acts, that the law looks ahead by


@dataclass(frozen=True, slots=True, kw_only=True)
class FuzzyPidConfig:
    """PID with fuzzy rules over angle and rate that set its gains: those of `rate_pid` (base: rate) or `pid` (engineering).

    Defaults are those of paper 003; docs/fuzzy-pid.md says what they are worth.
    """

    kind: Literal["fuzzy_pid"]
    base: Literal["rate", "engineering"] = "rate"
    tables: Literal["canonical", "even"] = "canonical"  # even: a turn to the left is flown as one to the right
    inference: Literal["min", "prod"] = "min"  # AND of two memberships
    kp: Gains3 | None = None  # K0; with base rate none: 0.7, 3 and 0 on each axis; with engineering as those of pid
    ki: Gains3 | None = None  # give all three gains or none
    kd: Gains3 | None = None  # their units are those of rate_pid or of pid
    kp_span: NonNegative = 100.0  # base rate: the most that the rules add to kp [N m s/rad]
    ki_span: NonNegative = 1.0  # and to ki [N m/rad]
    kd_span: NonNegative = 10.0  # and to kd [N m s^2/rad]
    alpha_share: Annotated[float, Gt(0), Le(1)] = 0.5  # base rate: weight of the newest acceleration [1]
    angle_scale_rad: Positive | None = None  # angle at the end of the rules' universe; none: 0.04, engineering: 0.02
    rate_scale_rad_s: Positive | None = None  # rate there; none: 0.04, engineering: 0.005
    rho: Annotated[float, Ge(0), Lt(1)] = 0.5  # base engineering: K = K0 (1 + rho F) [1]
    frequency_rad_s: Annotated[RadS, Gt(0)] = 0.25  # base engineering: as those of pid
    damping: Positive = 1.0  # likewise [1]
    integral_rad_s: NonNegative = 0.02  # likewise [rad/s]
    limit_nm: TorqueLimit | None = None  # likewise: torque about each axis from which on the integral stands


@dataclass(frozen=True, slots=True, kw_only=True)
class PidConfig:
    """PID on the angle with anti-windup. Gains from frequency, damping and integral pole, or given."""

    kind: Literal["pid"]
    frequency_rad_s: Annotated[RadS, Gt(0)] = 0.25  # of the loop's fast pair of poles
    damping: Positive = 1.0  # of that pair [1]
    integral_rad_s: NonNegative = 0.02  # the slow pole; 0.01 is enough where drag is made up for
    kp: Gains3 | None = None  # per body axis [N m/rad]; all three gains or none
    ki: Gains3 | None = None  # [N m/(rad s)]
    kd: Gains3 | None = None  # [N m s/rad]
    limit_nm: TorqueLimit | None = (
        None  # torque about each axis from which on the integral stands; none: the wheels' own
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerIntegratorConfig:
    """The rate is led along w = -beta sig(sigma)^(3/5): zero error after finite time. Li & Liu 2011, law (28).

    Defaults are for 0.1 N m wheels and about 45 kg m^2: beta as for no overshoot, sqrt(torque/(0.15 J sigma^0.2)). For
    smooth rates: docs/finite-time.md.
    """

    kind: Literal["power_integrator"]
    m: Positive = 1.1  # gain [rad/s^2]; without inertia_weight [N m]
    beta: Annotated[RadS, Gt(0)] = 0.13  # slope of the manifold
    inertia_weight: bool = (
        True  # the gain is an acceleration, for an inertia of any shape; False: a torque, as published
    )
    sampling: Literal["explicit", "implicit"] = "implicit"  # explicit: as published; it chatters at the period
    gyroscopic: bool = True  # make up for w x J w, as published; not where model.wheel_momentum is
    latency: Annotated[int, Ge(0), Le(5)] = 0  # control periods until a torque acts, that the law looks ahead by
    adapt_beta: bool = False  # lower beta with the torque that the wheels are thought to have left
    gain_check: Literal["refuse", "warn", "off"] = "refuse"  # what to do where m is below what the proof needs for beta


@dataclass(frozen=True, slots=True, kw_only=True)
class RatePidConfig:
    """The plain PID of paper 003: P on the rate, I on the angle, D on the acceleration. Defaults are the paper's."""

    kind: Literal["rate_pid"]
    kp: Gains3 = (0.7, 0.7, 0.7)  # on the rate, per body axis [N m s/rad]
    ki: Gains3 = (3.0, 3.0, 3.0)  # on the angle, the integral of the rate [N m/rad]
    kd: Gains3 = (0.0, 0.0, 0.0)  # on the acceleration [N m s^2/rad]
    alpha_share: Annotated[float, Gt(0), Le(1)] = 0.5  # weight of the newest acceleration, per step [1]


@dataclass(frozen=True, slots=True, kw_only=True)
class SmcConfig:
    """Sliding-mode law with adaptive surface slope, Zhang, Ye & Sun 2018, eqs (33)-(35)."""

    kind: Literal["smc"]
    k1: Positive = 5.6  # [N m s/rad]; k2 = 1/k1
    mu: Positive = 2.0
    beta0: Positive = 0.4
    beta_law: Literal["published", "lyapunov", "fixed"] = "published"


@dataclass(frozen=True, slots=True, kw_only=True)
class VariableStructureConfig:
    """Variable-structure law, tau = -(tau_max/epsilon) s, s = w + k q (a baseline). Made for `allocator: transpose`."""

    kind: Literal["variable_structure"]
    k: Positive = 0.12  # [rad/s]
    epsilon: Positive = 0.003  # boundary layer [rad/s]
