"""Asks the meter until it knows the thickness well enough, and ends the app. Standard library only."""

import ctos


@ctos.on_run
def work() -> None:
    enough = ctos.args()["enough_mm"]
    for times in (4, 16, 64, 256):
        found = ctos.call("meter", "measure", times=times)
        ctos.at(f"{found['taken']} values")
        if found["sd"] < enough:
            return ctos.finish(True, f"{found['mean']:.3f} mm, sd {found['sd']:.3f} mm")
        ctos.log(f"sd {found['sd']:.4f} mm is too much: once more")
    ctos.finish(False, "it could not be measured well enough")


ctos.run()
