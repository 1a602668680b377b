"""Event files as TensorBoard reads them."""

import struct

from tensorboardX.proto.event_pb2 import Event


def read_events(folder):
    """The events of a folder that have values."""
    kept = []
    for path in sorted(folder.glob("events*")):
        data, place = path.read_bytes(), 0
        while place < len(data):
            length, _ = struct.unpack_from("<QI", data, place)  # and a check sum
            start, place = place + 12, place + 12 + length + 4
            kept.append(Event.FromString(data[start : start + length]))
    return [event for event in kept if event.summary.value]
