from .build import wireframe as wireframe
from .frame import LetGo as LetGo, Wireframe as Wireframe
