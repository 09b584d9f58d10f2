#!/usr/bin/env python3
"""Publishes servo samples to Stillcut: a sine of current on two axes, 9000 samples a second.

Needs the package `iceoryx2` in the same minor version as Stillcut (0.10.x). Run as Stillcut's user:

    publish_samples.py --prefix stillcut --root /run/stillcut --seconds 10

It stands where a motion controller's own producer would; the layout is that of include/stillcut.h.
"""

import argparse
import ctypes
import math
import sys
import time

import iceoryx2 as iox2

MAX_AXES, MAX_SAMPLES, NAME_BYTES = 6, 32, 8
VALID_ALL = 7
RATE_HZ, BATCH = 9000.0, 9


class ServoAxis(ctypes.Structure):
    _fields_ = [("current_ref_a", ctypes.c_double), ("motor_angle_rad", ctypes.c_double), ("stage_position_m", ctypes.c_double)]


class ServoPoint(ctypes.Structure):
    _fields_ = [
        ("sequence", ctypes.c_uint64),
        ("t_ns", ctypes.c_uint64),
        ("spindle_angle_rad", ctypes.c_double),
        ("spindle_speed_rpm", ctypes.c_double),
        ("valid", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("axes", ServoAxis * MAX_AXES),
        ("accel_m_s2", ctypes.c_double * 3),
    ]


class ServoBatch(ctypes.Structure):
    _fields_ = [
        ("stream", ctypes.c_uint64),
        ("sample_rate_hz", ctypes.c_double),
        ("sample_count", ctypes.c_uint32),
        ("axis_count", ctypes.c_uint32),
        ("axis_names", (ctypes.c_char * NAME_BYTES) * MAX_AXES),
        ("points", ServoPoint * MAX_SAMPLES),
    ]

    @staticmethod
    def type_name() -> str:
        return "stillcut.ServoBatch.v2"


def open_service(node):
    """The servo service, tried for ever: Stillcut creates it and with it every limit, a producer only opens it."""
    pause_s = 0.01
    while True:
        try:
            name = iox2.ServiceName.new("Stillcut/Servo")
            return node.service_builder(name).publish_subscribe(ServoBatch).open()
        except iox2.PublishSubscribeOpenError as error:
            # Not there yet, or just being made or removed; all else is for a person.
            if not any(word in str(error) for word in ("DoesNotExist", "HangsInCreation", "IsMarkedForDestruction")):
                raise
        if pause_s == 0.01:
            print("waiting for Stillcut to create its service", file=sys.stderr)
        time.sleep(pause_s)
        pause_s = min(2.0 * pause_s, 0.25)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prefix", default="stillcut")
    parser.add_argument("--root", default="/run/stillcut")
    parser.add_argument("--seconds", type=float, default=10.0)
    arguments = parser.parse_args()

    config = iox2.config.default()
    config.global_cfg.prefix = iox2.FileName.new(arguments.prefix + "_")
    config.global_cfg.root_path = iox2.Path.new(arguments.root)
    node = (
        iox2.NodeBuilder.new()
        .name(iox2.NodeName.new("python-producer"))
        .config(config)
        .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
        .create(iox2.ServiceType.Ipc)
    )
    service = open_service(node)
    publisher = service.publisher_builder().create()

    batch = ServoBatch(stream=time.time_ns(), sample_rate_hz=RATE_HZ, sample_count=BATCH, axis_count=2)
    batch.axis_names[0].value = b"x1"
    batch.axis_names[1].value = b"y1"
    began, sequence = time.monotonic_ns(), 0
    while (time.monotonic_ns() - began) * 1e-9 < arguments.seconds:
        for point in batch.points[:BATCH]:
            t_s = sequence / RATE_HZ
            point.sequence = sequence
            point.t_ns = int(t_s * 1e9)
            point.spindle_angle_rad = 2.0 * math.pi * 20.0 * t_s
            point.spindle_speed_rpm = 1200.0
            point.valid = VALID_ALL | VALID_ALL << 3
            for axis in point.axes[:2]:
                axis.current_ref_a = 0.1 * math.sin(2.0 * math.pi * 100.0 * t_s)
            sequence += 1
        publisher.send_copy(batch)
        ahead_s = sequence / RATE_HZ - (time.monotonic_ns() - began) * 1e-9
        if ahead_s > 0.0:
            time.sleep(ahead_s)
    print(f"{sequence} samples published")


if __name__ == "__main__":
    main()
