"""The minimum lap time of a car on a road, and the line that it is driven on.

cross_sections.py    the road as lines from wall to wall, one station after the other
equations.py         the simulator's single-track equations, stated for CasADi
models.py            what moves along the road: the car, or a point mass
optimal_control.py   the lap as a nonlinear programme, solved by IPOPT
minimum_lap.py       the two together, from start to line
reference_line.py    a lap as a table: places, speeds and controls by station
speed_profile.py     the fastest speeds on a given line, by another way
replay.py            the line's controls in the simulator
checks.py            whether a minimum lap deserves its name
kept_laps.py         laps kept between processes
laps.py              laps beside each other, and the gaps between them
"""

SECTORS = 3
"""Of a lap, each a third of the centreline."""
