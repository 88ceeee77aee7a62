"""One module a command of `splatview`."""
