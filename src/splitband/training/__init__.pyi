from .checkpoints import Checkpoint as Checkpoint
from .loop import fit as fit
from .progress import History as History
from .progress import Progress as Progress
from .settings import Settings as Settings
from .settings import default_warmup as default_warmup
