"""A kettle: boils the water of one cup, and refuses when it is empty."""

import ctos

water = 2


@ctos.handler
def boil() -> None:
    global water
    if water == 0:
        raise ctos.Refused("the kettle is empty")
    water -= 1


@ctos.handler
def fill() -> None:
    global water
    water = 2


ctos.run()
