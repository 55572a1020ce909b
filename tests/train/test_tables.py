"""A run's tables as they grow, and go on."""

from carrl.train.folder import Table


def test_a_table_that_goes_on_keeps_the_columns_that_it_began_with(tmp_path):
    path = tmp_path / "evaluations.csv"
    begun = Table(path)
    begun.append({"frames": 100, "progress": 0.5})
    text = begun.text
    begun.close()
    going_on = Table(path, text)
    going_on.append({"lap_time": 23.4, "progress": 1.0, "frames": 200})
    going_on.close()
    assert path.read_text().splitlines() == ["frames,progress", "100,0.5", "200,1.0"]
