"""Files for ParaView."""

import xml.etree.ElementTree as ET

import meshio
import numpy as np

from taichi_eye.report.paraview import ParaviewWriter

NODES = np.array([[0.0, 0.0], [1e-3, 0.0], [0.0, 1e-3], [1e-3, 1e-3]])
TRIANGLES = np.array([[0, 1, 2], [1, 3, 2]])
WALL = np.array([[0.0, 1e-3], [0.5e-3, 0.9e-3], [1e-3, 0.5e-3]])


def add(writer, time_ms):
    writer.add_frame(
        time_ms,
        NODES,
        TRIANGLES,
        {"pressure_pa": NODES[:, 0] * time_ms, "velocity_m_s": NODES + time_ms},
        WALL,
        {"stress_kpa": WALL[:, 1].astype(np.float32)},
    )


def entries(folder):
    root = ET.parse(folder / "fields.pvd").getroot()
    assert root.tag == "VTKFile" and root.get("type") == "Collection"
    return [(float(e.get("timestep")), e.get("part"), e.get("name"), e.get("file")) for e in root.find("Collection")]


def test_collection_is_whole_after_every_frame(tmp_path):
    writer = ParaviewWriter(tmp_path / "fields")
    for count, time_ms in enumerate((0.0, 0.2315, 0.463), start=1):
        add(writer, time_ms)
        found = entries(tmp_path / "fields")
        assert len(found) == 2 * count
        assert found[-2:] == [
            (time_ms, "0", "fluid", f"fluid-{count - 1:04d}.vtu"),
            (time_ms, "1", "membrane", f"membrane-{count - 1:04d}.vtu"),
        ]
        files = {entry.name for entry in (tmp_path / "fields").iterdir()}
        assert files == {"fields.pvd", *(name for *_, name in found)}


def test_fields_come_back(tmp_path):
    add(ParaviewWriter(tmp_path), 2.0)
    fluid = meshio.read(tmp_path / "fluid-0000.vtu")
    np.testing.assert_array_equal(fluid.points, np.column_stack([NODES, np.zeros(4)]))
    np.testing.assert_array_equal(fluid.cells_dict["triangle"], TRIANGLES)
    np.testing.assert_array_equal(fluid.point_data["pressure_pa"], NODES[:, 0] * 2.0)
    np.testing.assert_array_equal(fluid.point_data["velocity_m_s"], np.column_stack([NODES + 2.0, np.zeros(4)]))
    membrane = meshio.read(tmp_path / "membrane-0000.vtu")
    np.testing.assert_array_equal(membrane.cells_dict["line"], [[0, 1], [1, 2]])
    np.testing.assert_array_equal(membrane.points[:, :2], WALL)
    np.testing.assert_array_equal(membrane.point_data["stress_kpa"], WALL[:, 1].astype(np.float32))
