"""Contributions to the channel, by transforms along frequency at as few times as hold the motion.

What is at rest takes one transform. What moves is divided into groups of nearly the same motion
(`groups`): once the common motion of a group is removed, its channel changes so slowly that all
slots are interpolated from a few times within the interval (`times`). Each time takes one
non-uniform FFT of the group along frequency, exact in delays and rates (`nonuniform_fft`); all
slots are matrix products of these (`channel`).
"""

from twin.radar.synthesis.channel import synthesize
from twin.radar.synthesis.contributions import Array, Complex, Contributions, direct_sum

__all__ = ["Array", "Complex", "Contributions", "direct_sum", "synthesize"]
