"""Contributions to the channel, by transforms along frequency at as few times as hold the motion.

What is at rest takes one transform. What moves is divided into groups of nearly the same motion
(`groups`): once the common motion of a group is removed, its channel changes so slowly that all
slots are interpolated from a few times within the interval (`times`). Each time takes one
non-uniform FFT of the group along frequency, exact in delays and rates (`nonuniform_fft`); all
slots are matrix products of these (`channel`). With Doppler within
symbols a few of these are what a receiver finds (`demodulated`).
"""

from twin.radar.synthesis.channel import synthesize
from twin.radar.synthesis.contributions import Array, Complex, Contributions, direct_sum
from twin.radar.synthesis.demodulated import demodulated

__all__ = ["Array", "Complex", "Contributions", "demodulated", "direct_sum", "synthesize"]
