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
_PILOT = "parts the pilot's remote control from the drone"
_LINK = "parts the UAV client from the autopilot"
_CONTROL = "gives control to another system id"

GUARDED: Final[dict[str, str]] = {
    **dict.fromkeys(("MAV_SYS_ID", "MAV_COMP_ID", "SYSID_THISMAV", "MAV_SYSID"), _ID),
    **dict.fromkeys(("SYSID_MYGCS", "MAV_GCS_SYSID*"), _CONTROL),
    **dict.fromkeys(("SYS_AUTOSTART", "SYS_AUTOCONFIG", "FORMAT_VERSION", "FRAME_CLASS", "FRAME_TYPE"), _RESET),
    **dict.fromkeys(("CBRK_*", "COM_LOW_BAT_ACT", "COM_OBL_RC_ACT", "COM_QC_ACT", "COM_IMB_PROP_ACT"), _FAILSAFE),
    **dict.fromkeys(("NAV_RCL_ACT", "NAV_DLL_ACT", "COM_RCL_EXCEPT", "COM_DLL_EXCEPT", "COM_OF_LOSS_T"), _FAILSAFE),
    **dict.fromkeys(
        ("COM_DL_LOSS_T", "COM_RC_LOSS_T", "COM_FAIL_ACT_T", "COM_POS_LOW_ACT", "COM_WIND_MAX_ACT"), _FAILSAFE
    ),
    **dict.fromkeys(("FS_*", "BATT_FS_*", "BATT?_FS_*", "GUID_TIMEOUT"), _FAILSAFE),
    **dict.fromkeys(("COM_ARM_*", "ARMING_*", "COM_PREARM_MODE", "BRD_SAFETY*"), _ARMING),
    **dict.fromkeys(("GF_*", "FENCE_*", "AVOID_ENABLE"), _FENCE),
    **dict.fromkeys(("FD_*", "AFS_*", "CHUTE_*", "COM_KILL_DISARM"), _END),
    **dict.fromkeys(("CAL_*", "COMPASS_OFS*", "COMPASS_DIA*", "COMPASS_ODI*", "COMPASS_SCALE*"), _CALIBRATION),
    **dict.fromkeys(("INS_*OFFS*", "INS*_*SCAL*", "AHRS_TRIM_*", "AHRS_ORIENTATION", "SENS_BOARD_*"), _CALIBRATION),
    **dict.fromkeys(("PWM_*", "CA_*", "SERVO*", "MOT_PWM_*", "MOT_SPIN_*"), _MOTORS),
    **dict.fromkeys(("UAVCAN_*", "CAN_*"), _CAN),
    **dict.fromkeys(("COM_RC_IN_MODE", "RC_MAP_*", "RC_CHAN_CNT", "RCMAP_*", "RC_PROTOCOLS", "FLTMODE_CH"), _PILOT),
    **dict.fromkeys(("MAV_[0-9]_*", "MAV_PROTO_VER", "MAV_SIGN*", "SER_*", "SERIAL*", "SR[0-9]_*"), _LINK),
}
"""Patterns of PX4's and ArduPilot's names, with the reasons."""


def is_guarded(name: str) -> bool:
    """Whether a parameter is guarded; ArduPilot ignores the case of names."""
    return any(fnmatchcase(name.upper(), pattern) for pattern in GUARDED)
