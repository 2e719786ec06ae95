"""Messages of a JSON head and a body of arrays, as other programs exchange them with the studio and with the loop. Without torch."""
