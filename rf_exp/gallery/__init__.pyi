from .draw import overview as overview
from .draw import panel as panel
from .draw import strip as strip
from .performance import perform as perform
from .performance import replay as replay
from .sheets import write_gallery as write_gallery
