"""Profile rd: few Gaussians are placed, fitted under the price of their bits, densified, pruned, coded and refined.

encode.py is the pipeline, in the order in which it runs, from a problem and a session (problem.py), settings and rate
control to the stream of an .sg file. Its steps ask Levels (levels.py) for sizes and errors, rate control
(rate_control.py, byte_limit.py, aim.py: a class for each kind of budget) for what the budget allows, and Schedule
(schedule.py) for the time.
"""

from sgmethod.profiles import Method
from sgmethod.settings.rd import RD

METHOD = Method(RD, encoder="sgmethod.rd.picture.encode", smallest_file="sgmethod.bitstream.v2.smallest_file")
