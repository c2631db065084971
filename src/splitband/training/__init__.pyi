from .loop import fit as fit
from .settings import History as History
from .settings import Progress as Progress
from .settings import TrainingSettings as TrainingSettings
from .settings import default_warmup as default_warmup
