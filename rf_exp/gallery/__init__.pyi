from .draw import overview as overview
from .draw import panel as panel
from .draw import strip as strip
from .performance import perform as perform
from .performance import play as play
from .sheets import show as show
