"""A mission up and down by MAVSDK through a radio at the edge of its range. MAVSDK gives up after some repetitions;
whoever flies then asks again, and so does this.

    link_mavsdk.py HOST:PORT
"""

import asyncio
import math
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

from mavsdk_mission import waypoint
from mavsdk_north import EARTH_RADIUS_M, PATIENCE_S, first


async def until_it_works(what, ask):
    """The result of `ask`, which may fail a few times."""
    for tried in range(1, 21):
        try:
            result = await ask()
            print(f"{what}: at try {tried}")
            return result
        except Exception as error:  # noqa: BLE001 - every failure of the library is a reason to ask again
            failure = error
    raise failure


async def mission(system):
    telemetry, mission = TelemetryAsync(system), MissionRawAsync(system)
    here = await first(telemetry.subscribe_position())
    north = [here.latitude_deg + math.degrees(10.0 * k / EARTH_RADIUS_M) for k in range(6)]
    items = [waypoint(seq, latitude, here.longitude_deg) for seq, latitude in enumerate(north)]
    await until_it_works("up", lambda: mission.upload_mission(items))
    stored = await until_it_works("down", mission.download_mission)
    assert [(i.seq, i.x, i.y) for i in stored[1:]] == [(i.seq, i.x, i.y) for i in items[1:]], stored


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
