"""Event files as TensorBoard reads them."""

import struct

from tensorboardX.proto.event_pb2 import Event, SessionLog


def read_events(folder):
    """The events that TensorBoard keeps: a start drops what a kill has made stale."""
    kept = []
    for path in sorted(folder.glob("events*")):
        data, place = path.read_bytes(), 0
        while place + 12 <= len(data):
            length, _ = struct.unpack_from("<QI", data, place)  # and a check sum
            start, place = place + 12, place + 12 + length + 4
            if place > len(data):
                break  # torn by a kill
            event = Event.FromString(data[start : start + length])
            if event.session_log.status == SessionLog.START:
                kept = [one for one in kept if one.step < event.step]
            kept.append(event)
    return [event for event in kept if event.summary.value]
