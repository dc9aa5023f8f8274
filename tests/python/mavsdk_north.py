"""Flies `sitl` by MAVSDK: waits for a healthy vehicle, reads and sets parameters, pushes north.

    mavsdk_north.py HOST:PORT
"""

import asyncio
import math
import sys

from mavsdk.asyncio import Autopilot, ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import AccelerationNed
from mavsdk.plugins.param import ParamError
from mavsdk.plugins.telemetry import FlightMode, LandedState

# Reached only by a failure; a busy machine needs less.
PATIENCE_S = 120.0
EARTH_RADIUS_M = 6_378_137.0


async def first(subscription, where=lambda value: True):
    """The first value of a subscription for which `where` holds."""

    async def search():
        async for value in subscription:
            if where(value):
                return value

    try:
        return await asyncio.wait_for(search(), PATIENCE_S)
    finally:
        await subscription.aclose()


async def look(system):
    telemetry = TelemetryAsync(system)
    # Together, as some come only every other second.
    health, position, home, battery, in_air, landed, level = await asyncio.gather(
        first(telemetry.subscribe_health(), where=lambda h: h.is_global_position_ok),
        first(telemetry.subscribe_position()),
        first(telemetry.subscribe_home()),
        first(telemetry.subscribe_battery()),
        first(telemetry.subscribe_in_air()),
        first(telemetry.subscribe_landed_state()),
        first(telemetry.subscribe_attitude_euler()),
    )
    assert health.is_local_position_ok and health.is_home_position_ok and health.is_armable, health
    assert health.is_gyrometer_calibration_ok and health.is_accelerometer_calibration_ok, health
    origin = await telemetry.get_gps_global_origin()
    metres_north = math.radians(position.latitude_deg - origin.latitude_deg) * EARTH_RADIUS_M
    assert abs(metres_north - 250.0) < 0.1, f"{metres_north} m north of the origin"
    assert abs(position.latitude_deg - home.latitude_deg) < 1e-6, (position, home)
    assert abs(position.relative_altitude_m - 100.0) < 0.1, position
    assert 14.0 < battery.voltage_v < 15.0 and battery.remaining_percent > 90.0, battery
    assert in_air and landed == LandedState.IN_AIR, landed
    assert abs(level.roll_deg) < 1e-3 and abs(level.pitch_deg) < 1e-3, level
    assert (await InfoAsync(system).get_identification()).legacy_uid == 1
    print(f"healthy, {metres_north:.1f} m north of the origin, {battery.voltage_v:.1f} V")


async def parameters(system):
    param = ParamAsync(system)
    everything = await param.get_all_params()
    floats = {p.name: p.value for p in everything.float_params}
    whole = {p.name: p.value for p in everything.int_params}
    assert math.isclose(floats["SCALE_ALT_M"], 100.0) and whole["SYSID_THISMAV"] == 1, (floats, whole)
    await param.set_param_float("RATE_ATTITUDE", 8.0)
    assert await param.get_param_float("RATE_ATTITUDE") == 8.0
    assert await param.get_param_int("SYSID_THISMAV") == 1
    try:
        await param.set_param_float("RATE_ATTITUDE", math.nan)
    except ParamError:
        pass
    assert await param.get_param_float("RATE_ATTITUDE") == 8.0, "not a number was taken"
    print(f"{len(floats) + len(whole)} parameters")


async def fly(system):
    telemetry, offboard = TelemetryAsync(system), OffboardAsync(system)
    await ActionAsync(system).arm()
    assert await first(telemetry.subscribe_armed())
    start = (await first(telemetry.subscribe_position_velocity_ned())).position

    # MAVSDK repeats the setpoint at 20 Hz until it gets another.
    await offboard.set_acceleration_ned(AccelerationNed(5.0, 0.0, 0.0))
    await offboard.start()
    assert await offboard.is_active()
    assert await first(telemetry.subscribe_flight_mode()) == FlightMode.OFFBOARD
    moved = await first(
        telemetry.subscribe_position_velocity_ned(), where=lambda m: m.position.north_m > start.north_m + 10.0
    )
    assert moved.velocity.north_m_s > 0.0 and abs(moved.position.east_m - start.east_m) < 1e-3, moved
    tilt = await first(telemetry.subscribe_attitude_euler(), where=lambda a: a.pitch_deg < -10.0)
    assert math.isclose(tilt.pitch_deg, -math.degrees(math.atan(5.0 / 9.81)), abs_tol=0.5), tilt
    print(f"pushed north: {moved.position.north_m:.1f} m at {moved.velocity.north_m_s:.1f} m/s")


async def main(address):
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(station) as mavsdk:
        await mavsdk.add_any_connection(f"udpout://{address}")
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None, "no vehicle"
        assert await system.get_system_id() == 1
        assert await system.autopilot_type() == Autopilot.ARDUPILOT
        await look(system)
        await parameters(system)
        await fly(system)
    print("ok")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
