"""A mission for `sitl` by MAVSDK: uploaded, read back, flown, paused; then it returns.

    mavsdk_mission.py HOST:PORT
"""

import asyncio
import math
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission_raw import MissionItem
from mavsdk.plugins.telemetry import FlightMode

from mavsdk_north import EARTH_RADIUS_M, PATIENCE_S, first

WAYPOINT, GLOBAL_RELATIVE_INT = 16, 6


def waypoint(seq, latitude_deg, longitude_deg):
    return MissionItem(
        seq=seq,
        frame=GLOBAL_RELATIVE_INT,
        command=WAYPOINT,
        current=int(seq == 0),
        autocontinue=1,
        param1=0.0,
        param2=0.0,
        param3=0.0,
        param4=math.nan,
        x=round(latitude_deg * 1e7),
        y=round(longitude_deg * 1e7),
        z=100.0,
        mission_type=0,
    )


async def mission(system):
    telemetry, mission, action = TelemetryAsync(system), MissionRawAsync(system), ActionAsync(system)
    here = await first(telemetry.subscribe_position())
    north = here.latitude_deg + math.degrees(60.0 / EARTH_RADIUS_M)
    # Item 0 is home, as with ArduPilot.
    items = [
        waypoint(0, here.latitude_deg, here.longitude_deg),
        waypoint(1, north, here.longitude_deg),
        waypoint(2, here.latitude_deg, here.longitude_deg),
    ]
    await mission.upload_mission(items)
    stored = await mission.download_mission()
    assert [(i.seq, i.x, i.y) for i in stored[1:]] == [(i.seq, i.x, i.y) for i in items[1:]], stored

    await mission.start_mission()
    await first(telemetry.subscribe_flight_mode(), where=lambda mode: mode == FlightMode.MISSION)
    await first(telemetry.subscribe_position(), where=lambda p: p.latitude_deg > (north + here.latitude_deg) / 2)
    progress = await first(mission.subscribe_mission_progress(), where=lambda p: p.current >= 1)
    assert progress.total in (2, 3), progress
    print(f"flown: item {progress.current} of {progress.total}")

    await mission.pause_mission()
    await first(telemetry.subscribe_velocity_ned(), where=lambda v: abs(v.north_m_s) < 0.1)
    await action.return_to_launch()
    await first(telemetry.subscribe_flight_mode(), where=lambda m: m == FlightMode.RETURN_TO_LAUNCH)
    await mission.clear_mission()
    assert len(await mission.download_mission()) <= 1, "cleared, and still there"


async def main(address):
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(station) as mavsdk:
        await mavsdk.add_any_connection(f"udpout://{address}")
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None, "no vehicle"
        await mission(system)
    print("ok")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
