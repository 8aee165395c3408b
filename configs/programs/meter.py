"""A sensor in Python: it is asked how thick something is. Standard library only."""

import ctos


@ctos.handler
def measure(times: int) -> dict:
    """Measures so many times, and answers the mean and its standard deviation."""
    thick = [ctos.rng().gauss(ctos.args()["thick_mm"], 0.02) for _ in range(times)]
    ctos.keep((ctos.state() or 0) + times)
    mean = sum(thick) / times
    spread = (sum((one - mean) ** 2 for one in thick) / times) ** 0.5
    return {"mean": mean, "sd": spread / times**0.5, "taken": ctos.state()}


@ctos.service_object
def meter(text: str, floats: list, ints: list):
    """`program.meter EXEC read`: one value, mm."""
    if text != "read":
        raise ctos.Refused("a meter takes: EXEC read")
    return ctos.Answer(text="mm", floats=[ctos.rng().gauss(ctos.args()["thick_mm"], 0.02)])


ctos.run()
