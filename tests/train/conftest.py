"""What tests of compiled updates share."""

import pytest
from torch.fx.experimental.proxy_tensor import make_fx


@pytest.fixture
def traced(monkeypatch):
    """Lets torch compute what was traced, operator by operator: to compile it would take half a minute."""

    def trace(function, inputs):
        graph = make_fx(lambda *tensors: function(*tensors))(*inputs)
        return lambda given: list(graph(*given))

    monkeypatch.setattr("carrl.algorithms.common.compiled_update.compile_native", trace)
