"""Parameters that a UAV client sets only if an option allows it (docs/protocol.md, section 17)."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Final

_ID = "gives the drone another id, by which nobody here knows it"
_RESET = "resets parameters, or makes another airframe of it, at the next start"
_FAILSAFE = "may switch a failsafe off"
_ARMING = "may switch checks before arming off"
_FENCE = "may switch the geofence off"
_END = "may end the flight by falling"
_CALIBRATION = "overwrites calibrations"
_MOTORS = "changes motors' order"
_CAN = "changes the CAN bus or its ids"
_PILOT = "parts the pilot's remote control from the drone, or changes what its switches do: one may stop the motors"
_LINK = "parts the UAV client from the autopilot"
_CONTROL = "gives control to another system id"

GUARDED: Final[dict[str, str]] = {
    **dict.fromkeys(("MAV_SYS_ID", "MAV_COMP_ID", "SYSID_THISMAV", "MAV_SYSID"), _ID),
    **dict.fromkeys(("SYSID_MYGCS", "MAV_GCS_SYSID*", "SYSID_ENFORCE", "MAV_OPTIONS"), _CONTROL),
    **dict.fromkeys(
        ("SYS_AUTOSTART", "SYS_AUTOCONFIG", "SYS_HITL", "FORMAT_VERSION", "FRAME_CLASS", "FRAME_TYPE"), _RESET
    ),
    **dict.fromkeys(("CBRK_*", "COM_LOW_BAT_ACT", "COM_OBL_RC_ACT", "COM_QC_ACT", "COM_IMB_PROP_ACT"), _FAILSAFE),
    **dict.fromkeys(("NAV_RCL_ACT", "NAV_DLL_ACT", "COM_RCL_EXCEPT", "COM_DLL_EXCEPT", "COM_OF_LOSS_T"), _FAILSAFE),
    **dict.fromkeys(
        ("COM_DL_LOSS_T", "COM_HLDL_LOSS_T", "COM_RC_LOSS_T", "COM_FAIL_ACT_T", "COM_POS_LOW_*", "COM_WIND_MAX*"),
        _FAILSAFE,
    ),
    **dict.fromkeys(("COM_ACT_FAIL_ACT", "COM_FLTT_LOW_ACT", "COM_FLT_TIME_MAX", "COM_POSCTL_NAVL"), _FAILSAFE),
    **dict.fromkeys(("COM_POS_FS_*", "COM_VEL_FS_*", "BAT*", "FS_*", "GUID_TIMEOUT"), _FAILSAFE),
    **dict.fromkeys(("COM_ARM*", "ARMING_*", "COM_PREARM_MODE", "COM_PARACHUTE", "BRD_SAFETY*"), _ARMING),
    **dict.fromkeys(("COM_POWER_COUNT", "COM_CPU_MAX", "COM_RAM_MAX", "SYS_HAS_*"), _ARMING),
    **dict.fromkeys(("GF_*", "FENCE_*", "AVOID_ENABLE"), _FENCE),
    **dict.fromkeys(("FD_*", "AFS_*", "CHUTE_*", "COM_KILL_DISARM", "COM_LKDOWN_TKO", "SYS_FAILURE_EN"), _END),
    **dict.fromkeys(("CAL_*", "COMPASS_OFS*", "COMPASS_DIA*", "COMPASS_ODI*", "COMPASS_SCALE*"), _CALIBRATION),
    **dict.fromkeys(("INS_*OFFS*", "INS*_*SCAL*", "AHRS_TRIM_*", "AHRS_ORIENTATION", "SENS_BOARD_*"), _CALIBRATION),
    **dict.fromkeys(("PWM_*", "CA_*", "SERVO*", "MOT_PWM_*", "MOT_SPIN_*"), _MOTORS),
    **dict.fromkeys(("UAVCAN_*", "CAN_*"), _CAN),
    **dict.fromkeys(("RC_*", "RC[0-9]*", "RCMAP_*", "COM_RC_*", "COM_FLTMODE*", "FLTMODE*", "BTN_*"), _PILOT),
    **dict.fromkeys(("COM_DISARM_MAN", "MAN_ARM_GESTURE", "MAN_KILL_GEST_T"), _PILOT),
    **dict.fromkeys(("MAV_[0-9]_*", "MAV_PROTO_VER", "MAV_SIGN*", "SER_*", "SERIAL*", "SR[0-9]_*"), _LINK),
}
"""Patterns of PX4's and ArduPilot's names, with the reasons."""


def is_guarded(name: str) -> bool:
    """Whether a parameter is guarded; ArduPilot ignores the case of names."""
    return any(fnmatchcase(name.upper(), pattern) for pattern in GUARDED)
