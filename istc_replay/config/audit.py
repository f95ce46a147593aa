"""The configuration's section `audit`: every threshold of the safety audit, with its source.

Unset levels are not used. Levels that lie past each other in the wrong order are refused.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, model_validator

from istc_replay.config.sections import Count, NonNegative, Positive, Section

#: The hardest that a car brakes, on dry asphalt (Cunto and Saccomanno 2008): DRAC and required braking end
#: here, since beyond it they tell no more than that contact cannot be braked away.
HARDEST_BRAKING_MPS2 = 12.68

Angle = Annotated[float, Field(gt=0, le=3.141592653589793)]
Braking = Annotated[float, Field(gt=0, le=HARDEST_BRAKING_MPS2)]
#: Keys of levels, least severe first, and whether smaller values are worse.
_ORDERED = (
    (("gap_minor_m", "gap_serious_m"), True),
    (("ttc_minor_s", "ttc_serious_s", "ttc_critical_s"), True),
    (("pet_minor_s", "pet_serious_s", "pet_critical_s"), True),
    (("thw_minor_s", "thw_serious_s", "thw_critical_s"), True),
    (("drac_minor_mps2", "drac_serious_mps2", "drac_critical_mps2"), False),
    (("required_minor_mps2", "required_serious_mps2", "required_critical_mps2"), False),
    (("braking_minor_mps2", "braking_serious_mps2", "braking_critical_mps2"), False),
    (("lateral_minor_mps2", "lateral_serious_mps2"), False),
    (("jerk_minor_mps3", "jerk_serious_mps3"), False),
    (("overspeed_minor_mps", "overspeed_serious_mps", "overspeed_critical_mps"), False),
    (("off_corridor_minor_m", "off_corridor_serious_m", "off_corridor_critical_m"), False),
    (("delta_v_serious_mps", "delta_v_critical_mps"), False),
    (("rear_end_rad", "crossing_rad", "head_on_rad"), False),
)


class AuditConfig(Section):
    """The safety audit of recorded traffic; docs/audit.md says what each measure is."""

    gap_minor_m: Positive = 0.5
    """Boxes this close while moving past each other (ours)."""
    gap_serious_m: Positive = 0.2
    """Boxes this close (ours); contact is critical."""
    ttc_minor_s: Positive = 3.0
    """Time to collision (SUMO's SSM device)."""
    ttc_serious_s: Positive = 1.5
    """Time to collision (SSAM)."""
    ttc_critical_s: Positive = 0.95
    """Time to collision (nuPlan)."""
    pet_minor_s: Positive = 5.0
    """Post-encroachment time (SSAM); longer ones are not looked for."""
    pet_serious_s: Positive = 1.5
    """Post-encroachment time (Peesapati et al.)."""
    pet_critical_s: Positive = 1.0
    """Post-encroachment time (Varhelyi)."""
    drac_minor_mps2: Braking = 3.0
    """Deceleration to avoid a crash (SUMO's SSM device)."""
    drac_serious_mps2: Braking = 3.4
    """Deceleration to avoid a crash (Huber et al.)."""
    drac_critical_mps2: Braking = 6.0
    """Deceleration to avoid a crash (emergency braking, Stellet et al.)."""
    required_minor_mps2: Braking = 3.0
    """Least braking that avoids contact, of either vehicle (as for DRAC)."""
    required_serious_mps2: Braking = 3.4
    """Least braking that avoids contact, of either vehicle (as for DRAC)."""
    required_critical_mps2: Braking = 6.0
    """Least braking that avoids contact, of either vehicle (as for DRAC)."""
    thw_minor_s: Positive = 1.8
    """Time headway (German advice, half of the speedometer)."""
    thw_serious_s: Positive = 0.9
    """Time headway (fined in Germany)."""
    thw_critical_s: Positive = 0.4
    """Time headway (fined in Austria)."""
    queue_mps: NonNegative = 5.0
    """Slower vehicles are in a queue: THW, RSS and rear-end TTC are told, but no finding (ours)."""
    rss_response_s: Positive = 1.0
    """RSS: response time rho (ad-rss: 1 s own, 2 s others)."""
    rss_acceleration_mps2: NonNegative = 3.5
    """RSS: largest acceleration during the response (ad-rss)."""
    rss_least_braking_mps2: Positive = 4.0
    """RSS: braking that everybody does at least (ad-rss)."""
    rss_most_braking_mps2: Positive = 8.0
    """RSS: braking of a leader at most (ad-rss)."""
    rss_correct_braking_mps2: Positive = 3.0
    """RSS: braking of a vehicle in its own lane that meets another head on (ad-rss)."""
    rss_lateral_acceleration_mps2: NonNegative = 0.2
    """RSS: largest acceleration across during the response (ad-rss)."""
    rss_lateral_braking_mps2: Positive = 0.8
    """RSS: braking across at least (ad-rss)."""
    rss_margin_m: NonNegative = 0.1
    """RSS: distance across that is always kept, mu (ad-rss)."""
    delta_v_serious_mps: Positive = 11.11
    """Change of speed in a collision with serious consequences (40 km/h)."""
    delta_v_critical_mps: Positive = 19.44
    """Change of speed in a collision with critical consequences (70 km/h)."""
    exposure_ttc_s: Positive = 3.0
    """Times below this count for TET and TIT (Minderhoud and Bovy)."""
    rear_end_rad: Angle = 0.5235987755982988
    """Courses that differ by less are one direction, rear end (SSAM, 30 degrees)."""
    crossing_rad: Angle = 1.4835298641951802
    """Courses that differ by more cross (SSAM, 85 degrees); less is a lane change."""
    head_on_rad: Angle = 2.6179938779914944
    """Courses that differ by more meet head on (ours, 150 degrees)."""
    braking_minor_mps2: Positive = 3.4
    """A vehicle's braking (Huber et al.)."""
    braking_serious_mps2: Positive = 4.05
    """A vehicle's braking (nuPlan)."""
    braking_critical_mps2: Positive = 6.0
    """A vehicle's braking (emergency braking, Stellet et al.)."""
    lateral_minor_mps2: Positive = 4.89
    """Lateral acceleration (nuPlan)."""
    lateral_serious_mps2: Positive | None = None
    """Lateral acceleration."""
    jerk_minor_mps3: Positive = 4.13
    """Longitudinal jerk (nuPlan)."""
    jerk_serious_mps3: Positive = 12.65
    """Longitudinal jerk (UN R157)."""
    yaw_rate_minor_radps: Positive = 0.95
    """Yaw rate (nuPlan)."""
    steering_max_rad: Annotated[float, Field(gt=0, lt=1.5)] = 0.7
    """A bicycle's steering follows from its curvature; more than this is not a car's (ours)."""
    steering_rate_max_radps: Positive = 1.0
    """Rate of the steering that follows from the curvature (ours)."""
    side_slip_max_rad: Angle = 0.3490658503988659
    """Course against the heading, less that of a rolling rear axle (ours, 20 degrees)."""
    speed_limit_mps: Positive | None = None
    """Speed limit, for all vehicles; unset: speeds are not judged."""
    overspeed_minor_mps: NonNegative = 0.8333333333333334
    """Above the limit by this (3 km/h, the tolerance of German speed checks)."""
    overspeed_serious_mps: Positive = 5.833333333333333
    """Above the limit by this (21 km/h, German catalogue of fines)."""
    overspeed_critical_mps: Positive = 8.61111111111111
    """Above the limit by this (31 km/h, German ban from driving in towns)."""
    off_corridor_minor_m: NonNegative = 0.1
    """The recorded box out of its planned corridor by this (ours); where there is a plan."""
    off_corridor_serious_m: Positive | None = None
    """The recorded box out of its planned corridor by this."""
    off_corridor_critical_m: Positive | None = None
    """The recorded box out of its planned corridor by this."""
    horizon_s: Positive = 5.0
    """Contacts further ahead are not looked for."""
    near_m: Positive = 3.0
    """Pairs are sampled within this distance, whatever their speeds."""
    least_step_s: Positive = 0.02
    """Common times of all vehicles are no closer than this."""
    moving_mps: Positive = 0.5
    """A slower vehicle stands."""
    relative_mps: NonNegative = 0.5
    """Pairs with less relative speed queue or travel together: no TTC, no DRAC, no gap findings."""
    grazing_m: NonNegative = 0.1
    """Boxes that would touch by less than this, as seen along their relative velocity, only graze."""
    acceleration_bound_mps2: Positive = 10.0
    """Between samples a vehicle accelerates by no more: a h^2 / 8 bounds its position."""
    turning_radps: Positive = 0.1
    """A vehicle that yaws by more turns (ours): straight-line contacts that its arc avoids are minor."""
    release_ratio: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 1.3333333333333333
    """An event ends past its minor threshold by this factor (TTC 1.5 s: 2 s)."""
    bridge_s: NonNegative = 0.3
    """Interruptions of an event up to this are bridged."""
    least_samples: Count = 2
    """Samples past a threshold that make an event or a severity; one is enough for contact."""
    encounter_pause_s: NonNegative = 2.0
    """Events of one pair that are no further apart are one encounter."""
    smoothing_samples: Annotated[int, Field(ge=3)] = 9
    """Samples of a Savitzky-Golay fit of order 2, odd, and at least so many as span smoothing_s."""
    smoothing_s: Positive = 0.8
    """Least span of a fit."""
    gap_periods: Positive = 3.0
    """A pause of more than this many median periods is a gap in the data."""
    position_sigma_m: NonNegative = 0.1
    """Noise of positions: three of it are added to what a vehicle can travel between samples."""
    heading_course_rad: Angle = 0.5235987755982988
    """A heading this far from the course contradicts it."""
    heading_speed_mps: Positive = 2.0
    """Courses of slower vehicles are not compared with their headings."""
    frozen_samples: Count = 3
    """A pose that repeats this often, though the speed says otherwise, is frozen."""
    clock_step_s: Positive = 0.1
    """Log time less the message's own may change by this from one message to the next."""
    clock_drift_ppm: Positive = 500.0
    """Log time less the message's own may drift by this, where it sums up to a clock step."""
    speed_implausible_mps: Positive = 90.0
    """A faster vehicle's speed is not in m/s."""
    length_implausible_m: Positive = 30.0
    """A longer vehicle's size is not in m."""
    length_least_m: Positive = 1.0
    """A shorter vehicle's size is not in m."""
    dimension_change_m: Positive = 0.1
    """A vehicle's length and width may change by this."""

    @model_validator(mode="after")
    def _levels_are_in_order(self) -> Self:
        for names, smaller_is_worse in _ORDERED:
            values = [(name, getattr(self, name)) for name in names if getattr(self, name) is not None]
            for (mild, one), (severe, two) in pairwise(values):
                if two > one if smaller_is_worse else two < one:
                    order = "above" if smaller_is_worse else "below"
                    raise ValueError(
                        f"{severe} = {two} is {order} {mild} = {one}: the severer level comes later"
                    )
        if self.smoothing_samples % 2 == 0:
            raise ValueError(
                f"smoothing_samples = {self.smoothing_samples} is even: a fit has a middle sample"
            )
        return self
