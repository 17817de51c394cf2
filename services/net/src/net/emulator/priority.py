"""Gives the emulator priority over other programs: a packet is due whether or not the machine is busy.

SCHED_FIFO, to which all ordinary programs give way, needs CAP_SYS_NICE, and a kernel that gives a container real time
(one with CONFIG_RT_GROUP_SCHED does not by itself). A nice value below 0 needs CAP_SYS_NICE too; it only has an effect
within the container, against the captures: between containers `cpu_shares` decides. Without either the emulator runs
as it is, and the counters show how late packets were.
"""

from __future__ import annotations

import os

NICE = -15


def raise_priority() -> str:
    """Raise the priority as far as possible; returns `fifo`, `nice -15` or `none`."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except PermissionError:
        try:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
        except PermissionError:
            return "none"
        return f"nice {NICE}"
    return "fifo"
