import numpy as np
import pytest

from teaching.kernels import warm_up
from teaching.task import Task
from teaching.task_file import load_task


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels():
    warm_up()


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture(scope="session")
def paper() -> Task:
    return load_task("paper")
