"""The errors of the testbed, in one tree; `testbed.bootstrap`, which stands alone, has its own.

TestbedError            something that ends a command with one line and exit code 1
├── UserError           a wrong option or file: the line names it and what was expected (exit code 2)
├── DockerError         Docker is missing, refuses, or a container is not well
│   └── FleetError      Docker works, the fleet does not: the attempt fails, the next one may not
│       ├── ContainerDied       a container ended that should run; names it, with its last log lines
│       ├── ContainerUnhealthy  a container did not become healthy in time; likewise
│       └── ProbesLate          the machine was too busy for the links to be measured: the attempt is void
├── LinksOff            the links are not as in their profile: the attempt is void
├── Interrupted         Ctrl-C or SIGTERM ended the run (exit code 130)
├── SchedulerEnded      a campaign's scheduler on another machine is gone
└── ResultsError        a results folder that cannot be read
"""

from __future__ import annotations


class TestbedError(Exception):
    """Base of every error that the testbed raises on purpose."""

    __test__ = False
    exit_code = 1


class UserError(TestbedError):
    """A wrong option or file: the message names it, its value and what was expected."""

    exit_code = 2


class DockerError(TestbedError):
    """Docker is missing, refuses, or a container is not well."""


class FleetError(DockerError):
    """Docker works and the fleet does not: this fails an attempt, and the run goes on."""


class ContainerDied(FleetError):
    """A container ended that should run; the message has its name and its last log lines."""


class ContainerUnhealthy(FleetError):
    """A container did not become healthy in time; the message has its name and its last log lines."""


class ProbesLate(FleetError):
    """The machine was too busy for the links to be measured, which says nothing about what was to fly on them."""


class LinksOff(TestbedError):
    """The links are not as in their profile: an attempt on them would prove nothing."""


class Interrupted(TestbedError):
    """Ctrl-C or SIGTERM: everything was ended, and the captures are kept."""

    exit_code = 130


class SchedulerEnded(TestbedError):
    """A campaign's scheduler is gone, and with it who flies for it."""


class ResultsError(TestbedError):
    """A results folder that cannot be read."""
