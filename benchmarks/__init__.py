"""Speed and time-to-a-lap of CarRL beside other libraries; `scripts/bench` runs it."""
