"""Dealing for a whole team from its plan: on all cores or on a cluster, write-once and resumable."""
