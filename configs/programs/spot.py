"""The Tool that finds a bright spot, in Python with OpenCV and NumPy, in place of `vss.tool_spot_find`.

The brightest place of the smoothed picture, then a Gaussian fitted to the pixels around it by Gauss-Newton steps.
"""

import base64

import cv2
import numpy as np

import ctos

HALF = 9  # half the window that is fitted, px

# One thread: the same picture gives the same bits.
cv2.setNumThreads(1)


def unseen(reason: str) -> dict:
    return {"Err": {"outcome": "Unseen", "reason": reason}}


@ctos.handler
def locate_spot(frame: dict) -> dict:
    """Where the spot of a picture is."""
    pixels = np.frombuffer(base64.b64decode(frame["pixels"]), np.uint8)
    if frame["format"] != "Grey8" or pixels.size != frame["width"] * frame["height"]:
        return {"Err": {"outcome": "Fault", "reason": f"{pixels.size} pixels of {frame['format']}"}}
    picture = pixels.reshape(frame["height"], frame["width"])
    # What varies slowly is background: light, the table, the arm.
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.5)
    stands_out = smooth - cv2.GaussianBlur(smooth, (0, 0), 8.0)
    spread = 1.4826 * float(np.median(np.abs(stands_out)))
    threshold = max(8.0 * spread, 5.0)
    _, brightest, _, (column, row) = cv2.minMaxLoc(stands_out)
    if brightest < threshold:
        return unseen(f"nothing stands out: brightest {brightest:.1f}, needed {threshold:.1f}")
    background = float(smooth[row, column] - brightest)
    top, left = max(row - HALF, 0), max(column - HALF, 0)
    window = picture[top : row + HALF + 1, left : column + HALF + 1].astype(float)
    v, u = np.mgrid[top : top + window.shape[0], left : left + window.shape[1]].astype(float)
    used = window < 255
    # u, v, height, width, background
    fit = np.array([column, row, brightest, 2.0, background])
    for _ in range(30):
        du, dv = u - fit[0], v - fit[1]
        square = du**2 + dv**2
        bell = np.exp(-square / (2.0 * fit[3] ** 2))
        slope = fit[2] * bell
        jacobian = np.stack(
            [slope * du / fit[3] ** 2, slope * dv / fit[3] ** 2, bell, slope * square / fit[3] ** 3, np.ones_like(u)], axis=-1
        )[used]
        residual = (window - slope - fit[4])[used]
        step, *_ = np.linalg.lstsq(jacobian, residual, rcond=None)
        fit += step
        fit[3] = min(max(fit[3], 0.4), HALF)
        if np.abs(step[:2]).max() < 1e-6:
            break
    if abs(fit[0] - column) > 3 or abs(fit[1] - row) > 3 or fit[3] > 4.0 or fit[2] < threshold:
        return unseen("what stands out is no spot")
    variance = float(residual @ residual) / max(len(residual) - 5, 1)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * variance
    _, labels, about, _ = cv2.connectedComponentsWithStats((stands_out > threshold).astype(np.uint8))
    return {
        "Ok": {
            "u": fit[0],
            "v": fit[1],
            "sd_u": covariance[0, 0] ** 0.5,
            "sd_v": covariance[1, 1] ** 0.5,
            "area": int(about[labels[row, column], cv2.CC_STAT_AREA]),
            "amplitude": fit[2],
            "sigma": fit[3],
            "background": fit[4],
            "noise": variance**0.5,
            "flags": {
                "touches_border": window.shape != (2 * HALF + 1, 2 * HALF + 1),
                "saturated": bool((~used).any()),
                "elongated": False,
                "second": False,
                "structured": False,
            },
        }
    }


ctos.run()
