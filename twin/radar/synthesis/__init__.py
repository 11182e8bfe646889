"""Contributions to the channel, by transforms along frequency at as few times as hold the motion.

What is at rest takes one transform. What moves is divided into groups of nearly the same motion
(`groups`): with their common motion taken out they change so slowly that a few times within the
interval tell all slots (`times`). Each time takes one non-uniform FFT of the group along frequency,
exact in delays and rates (`transforms`); all slots are matrix products of these (`channel`).
"""

from twin.radar.synthesis.channel import synthesize
from twin.radar.synthesis.contributions import Array, Complex, Contributions, direct_sum

__all__ = ["Array", "Complex", "Contributions", "direct_sum", "synthesize"]
