mod buses;
mod recorded;
mod told_at_once;
