"""A control room in Python: commands the Dispatcher, and has the result judged. Standard library only."""

import ctos


@ctos.on_run
def work() -> None:
    command = ctos.args()
    answer = ctos.call(
        "dispatcher", "put_tape", deadline_s=1800.0, symbol=command["symbol"], arguments=command["arguments"]
    )
    if answer["symbol"] != command["success"]:
        return ctos.finish(False, f"{answer['symbol']}: {answer['text']}")
    if "judge" not in command:
        return ctos.finish(True, answer["symbol"])
    result = ctos.call(command["judge"], "judge", seconds=0.0, notes=answer["text"])
    ctos.finish(result["ok"], result["text"])


ctos.run()
