"""How the task's plane lies in the reach of the arm."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from hm_driver.geometry import ArmGeometry, joint_to_cartesian
from tools.report.figures import drawing
from tools.report.session_data import FloatArray, SessionData


def draw(data: SessionData) -> Figure:
    """From above: reach, plane and path of the handle. From the side: heights."""
    task, geometry, cycles = data.task, data.geometry, data.cycles
    figure = Figure(figsize=(11.5, 5.2))
    grid = figure.add_gridspec(
        1, 2, width_ratios=(1.35, 1.0), left=0.075, right=0.985, top=0.92, bottom=0.115, wspace=0.2
    )
    above, side = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    reach = reach_outline(geometry)
    above.add_patch(
        Polygon(
            reach[:, ::-1],
            closed=True,
            facecolor="#eef3f7",
            edgecolor=drawing.BLUE,
            linewidth=1.4,
            label="reach of the arm",
        )
    )
    half = 0.5 * task.size
    for thing in task.objects:
        inside = [(min(half, max(-half, x)), min(half, max(-half, y))) for x, y in thing.outline]
        corners = [task.to_handle(x, y, task.surface_z)[:2] for x, y in inside]
        above.add_patch(
            Polygon(
                [(y, x) for x, y in corners],
                closed=True,
                facecolor=thing.hex,
                alpha=0.45,
                edgecolor=drawing.INK,
                linewidth=0.8,
            )
        )
        x, y = np.mean(corners, axis=0)
        above.text(
            y, x, f"{thing.name}\n{thing.stiffness:g} N/m", ha="center", va="center", fontsize=10.5, zorder=6
        )
    every = max(1, len(cycles.time_s) // 4000)
    above.plot(
        cycles.y[::every],
        cycles.x[::every],
        color=drawing.INK,
        linewidth=0.4,
        alpha=0.45,
        label="path of the handle",
    )
    above.set_xlabel("y, to the right [m]")
    above.set_ylabel("x, towards the user [m]")
    above.set_title("From above")
    above.set_aspect("equal")
    above.margins(0.05)
    above.autoscale_view()
    above.invert_yaxis()
    drawing.draw_legend(above, loc="upper left", fontsize=10, borderaxespad=0.1, handlelength=1.2)
    _draw_side(side, data)
    return figure


def _draw_side(axes: Axes, data: SessionData) -> None:
    task, geometry, cycles = data.task, data.geometry, data.cycles
    half = 0.5 * task.size
    left, right = (task.to_handle(x, 0.0, 0.0)[0] for x in (-half, half))
    surface, deepest = task.handle_z(0.0), task.handle_z(task.depth_max)
    axes.add_patch(
        Rectangle(
            (geometry.r_min, geometry.z_min),
            geometry.r_max - geometry.r_min,
            geometry.z_max - geometry.z_min,
            facecolor="#eef3f7",
            edgecolor=drawing.BLUE,
            linewidth=1.4,
        )
    )
    axes.add_patch(
        Rectangle(
            (left, deepest),
            right - left,
            surface - deepest,
            facecolor=drawing.ORANGE,
            alpha=0.25,
            linewidth=0,
        )
    )
    axes.plot([left, right], [surface, surface], color=drawing.INK, linewidth=2.2)
    axes.text((left + right) / 2, surface + 0.012, "surface", ha="center", va="bottom")
    axes.text(
        (left + right) / 2,
        deepest - 0.008,
        f"deepest that the task needs: {1e3 * task.depth_max:.0f} mm",
        ha="center",
        va="top",
        fontsize=10.5,
    )
    every = max(1, len(cycles.time_s) // 4000)
    axes.plot(cycles.x[::every], cycles.z[::every], color=drawing.INK, linewidth=0.4, alpha=0.45)
    axes.set_xlabel("x, towards the user [m]")
    axes.set_ylabel("z, up [m]")
    axes.set_title("From the side")
    axes.set_aspect("equal")
    axes.margins(0.05)
    axes.autoscale_view()


def reach_outline(geometry: ArmGeometry, n: int = 40) -> FloatArray:
    """Outline of the arm's reach from above, x and y in the device's frame [m], shape (2 n, 2)."""
    angles = np.linspace(geometry.phi_min, geometry.phi_max, n).tolist()
    outer = [joint_to_cartesian(geometry.r_max, angle, 0.0, geometry.r0)[:2] for angle in angles]
    inner = [joint_to_cartesian(geometry.r_min, angle, 0.0, geometry.r0)[:2] for angle in reversed(angles)]
    return np.array(outer + inner)
