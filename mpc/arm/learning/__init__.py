"""Learners find environments here in which arms with pneumatic muscles move, many at a time on a compiled plant."""
