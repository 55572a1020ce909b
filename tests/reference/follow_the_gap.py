"""Follow-the-gap for one scan, beam by beam, as the F1TENTH survey describes it, for its scanner of 1,080 beams."""

import math


def mean(values, middle, count, low, high):
    """Of `count` values about the middle, one more of them before it than behind if they are even; 0 outside."""
    begin = middle - count // 2
    return sum(values[index] for index in range(max(begin, low), min(begin + count, high))) / count


def follow_the_gap(scan):
    """Steering angle, rad, and speed, m/s, of ranges, m."""
    ahead = scan[135:-135]
    ranges = [min(mean(ahead, beam, 3, 0, len(ahead)), 10.0) for beam in range(len(ahead))]
    nearest = min(range(len(ranges)), key=ranges.__getitem__)
    low, high = nearest + 160, len(ranges)
    if high - low <= 5:
        low, high = 0, nearest - 160
    best = max(range(low, high), key=lambda beam: mean(ranges, beam, 80, low, high))
    full_turn = (best + 0.5 - len(ranges) / 2) * 2 * math.pi / 1080
    steering = min(max(full_turn / 2, -0.4), 0.4)
    return steering, 3.0 if abs(steering) > 0.174 else 5.0
