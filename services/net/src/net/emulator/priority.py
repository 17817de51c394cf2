"""Puts the emulator before other programs: a packet's time is over whether or not the machine is busy.

SCHED_FIFO, which any ordinary program makes way for, needs CAP_SYS_NICE, and a kernel that gives a container real time
(one with CONFIG_RT_GROUP_SCHED does not). A nice value below 0 needs CAP_SYS_NICE too; it counts within the container
only, against the captures: between containers it is `cpu_shares` that counts. Without either it goes on as it is, and
the counters have how late packets were.
"""

from __future__ import annotations

import os

NICE = -15


def raise_priority() -> str:
    """What was to be had: `fifo`, `nice -15` or `none`."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except PermissionError:
        try:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
        except PermissionError:
            return "none"
        return f"nice {NICE}"
    return "fifo"
