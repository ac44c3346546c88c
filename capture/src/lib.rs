//! Devices to one Recording: clock, sync, recorder, replay, health.
