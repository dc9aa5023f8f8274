"""Flies `sitl` by MAVSDK's actions and offboard setpoints, with a fence, and takes a picture.

    mavsdk_guided.py HOST:PORT

`sitl` stands on the ground in an open world.
"""

import asyncio
import math
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.camera import CameraAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.geofence import Circle, FenceType, GeofenceData, Point
from mavsdk.plugins.offboard import PositionNedYaw, VelocityBodyYawspeed
from mavsdk.plugins.telemetry import FlightMode

from mavsdk_north import EARTH_RADIUS_M, PATIENCE_S, first


async def reach(telemetry, north, east, up):
    """Waits until the vehicle is at a place, metres from its origin."""

    def there(m):
        place = (m.position.north_m, m.position.east_m, -m.position.down_m)
        return math.dist(place, (north, east, up)) < 2.0

    await first(telemetry.subscribe_position_velocity_ned(), where=there)


async def fly(system):
    action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)
    home = await first(telemetry.subscribe_home())
    await action.arm()
    await action.set_takeoff_altitude(15.0)
    await action.takeoff()
    await reach(telemetry, 0, 0, 15)
    print("took off to 15 m")

    await offboard.set_position_ned(PositionNedYaw(40.0, 30.0, -25.0, 90.0))
    await offboard.start()
    await reach(telemetry, 40, 30, 25)
    await first(telemetry.subscribe_attitude_euler(), where=lambda a: abs(a.yaw_deg - 90.0) < 1.0)
    # Forward is east now.
    await offboard.set_velocity_body(VelocityBodyYawspeed(5.0, 0.0, 0.0, 0.0))
    await first(
        telemetry.subscribe_position_velocity_ned(),
        where=lambda m: m.position.east_m > 60.0 and abs(m.velocity.east_m_s - 5.0) < 0.2,
    )
    await offboard.stop()
    print("followed a position, and a velocity of the body")

    north = math.degrees(80.0 / EARTH_RADIUS_M)
    height = home.absolute_altitude_m + 35.0
    # A setpoint that was on its way when offboard stopped takes the vehicle back, as it takes ArduCopter.
    arrived = asyncio.ensure_future(reach(telemetry, 80, 0, 35))
    while not arrived.done():
        await action.goto_location(home.latitude_deg + north, home.longitude_deg, height, math.nan)
        await asyncio.wait([arrived], timeout=5.0)
    await arrived
    print("went to a place on Earth, and its height")


async def fence(system):
    geofence, offboard, telemetry = GeofenceAsync(system), OffboardAsync(system), TelemetryAsync(system)
    home = await first(telemetry.subscribe_home())
    centre = Point(home.latitude_deg, home.longitude_deg)
    await geofence.upload_geofence(GeofenceData([], [Circle(centre, 150.0, FenceType.INCLUSION)]))
    await offboard.set_velocity_body(VelocityBodyYawspeed(0.0, -15.0, 0.0, 0.0))
    await offboard.start()
    # BRAKE, which MAVSDK calls HOLD or does not know.
    await first(telemetry.subscribe_flight_mode(), where=lambda mode: mode != FlightMode.OFFBOARD)
    still = lambda m: abs(m.velocity.north_m_s) < 0.1  # noqa: E731
    stopped = await first(telemetry.subscribe_position_velocity_ned(), where=still)
    assert math.hypot(stopped.position.north_m, stopped.position.east_m) < 150.0, stopped
    await geofence.clear_geofence()
    print(f"the fence held at {stopped.position.north_m:.0f} m")


async def camera(system):
    camera = CameraAsync(system)
    found = await first(camera.subscribe_camera_list(), where=lambda found: len(found.cameras) > 0)
    about = found.cameras[0]
    assert (about.horizontal_resolution_px, about.vertical_resolution_px) == (100, 100), about
    shot = asyncio.ensure_future(first(camera.subscribe_capture_info()))
    await asyncio.sleep(0)
    await camera.take_photo(about.component_id)
    info = await shot
    assert info.is_success and info.index == 0, info
    print(f"a picture by {about.model_name}")


async def main(address):
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(station) as mavsdk:
        await mavsdk.add_any_connection(f"udpout://{address}")
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None, "no vehicle"
        await fly(system)
        await fence(system)
        await camera(system)
    print("ok")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
