"""Rows of the carrier plans: who radiates, from where, through which transponder, how strongly.

A row: station, latitude, longitude, transponder, symbol rate kHz, level dBm, dish width deg, white dB, wander dB.
"""

Row = tuple[str, float, float, str, int, float, float, float, float]

#: four users on each of four transponders
KU16: tuple[Row, ...] = (
    ("Rostov-on-Don", 47.23, 39.72, "Ku1", 1000, -42.9, 0.62, 0.150, 0.0),
    ("Saint Petersburg", 59.94, 30.31, "Ku1", 1200, -42.4, 0.36, 0.140, 0.0),
    ("Kaliningrad", 54.71, 20.51, "Ku1", 720, -43.5, 0.88, 0.155, 0.0),
    ("Moscow", 55.75, 37.62, "Ku1", 1200, -42.2, 0.31, 0.135, 0.0),
    ("Yekaterinburg", 56.84, 60.61, "Ku2", 1000, -42.8, 0.48, 0.150, 0.0),
    ("Vorkuta", 67.50, 64.05, "Ku2", 640, -43.8, 0.95, 0.165, 0.0),
    ("Omsk", 54.99, 73.37, "Ku2", 880, -43.1, 0.55, 0.150, 0.0),
    ("Tyumen", 57.15, 65.53, "Ku2", 1120, -42.6, 0.33, 0.145, 0.0),
    ("Krasnoyarsk", 56.01, 92.87, "Ku3", 800, -43.2, 0.72, 0.160, 0.30),
    ("Gorno-Altaysk", 51.96, 85.96, "Ku3", 560, -43.9, 0.90, 0.165, 0.0),
    ("Tiksi", 71.64, 128.87, "Ku3", 640, -43.6, 0.78, 0.165, 0.0),
    ("Kyzyl", 51.72, 94.44, "Ku3", 1120, -42.7, 0.42, 0.140, 0.0),
    ("Blagoveshchensk", 50.27, 127.54, "Ku4", 960, -43.0, 0.40, 0.150, 0.0),
    ("Yuzhno-Sakhalinsk", 46.96, 142.73, "Ku4", 720, -43.4, 0.65, 0.160, 0.0),
    ("Petropavlovsk-Kamchatsky", 53.02, 158.65, "Ku4", 640, -43.7, 0.82, 0.165, 0.0),
    ("Khabarovsk", 48.48, 135.07, "Ku4", 1200, -42.5, 0.32, 0.140, 0.0),
)

#: sixteen users more; two of them take the places of carriers that leave the plan
KU_MORE: tuple[Row, ...] = (
    ("Petrozavodsk", 61.79, 34.36, "Ku1", 560, -43.9, 0.85, 0.160, 0.0),
    ("Krasnodar", 45.04, 38.98, "Ku1", 640, -43.4, 0.58, 0.155, 0.0),
    ("Astrakhan", 46.35, 48.04, "Ku1", 640, -43.5, 0.70, 0.155, 0.0),
    ("Saratov", 51.53, 46.03, "Ku1", 720, -43.2, 0.45, 0.150, 0.0),
    ("Kurgan", 55.44, 65.34, "Ku2", 640, -43.3, 0.40, 0.150, 0.0),
    ("Khanty-Mansiysk", 61.00, 69.02, "Ku2", 640, -43.6, 0.66, 0.160, 0.0),
    ("Salekhard", 66.53, 66.60, "Ku2", 560, -43.8, 0.90, 0.165, 0.0),
    ("Tobolsk", 58.20, 68.25, "Ku2", 720, -43.1, 0.52, 0.150, 0.0),
    ("Novosibirsk", 55.03, 82.92, "Ku3", 720, -43.0, 0.38, 0.145, 0.0),
    ("Norilsk", 69.35, 88.20, "Ku3", 560, -43.9, 0.92, 0.165, 0.0),
    ("Abakan", 53.72, 91.44, "Ku3", 720, -43.2, 0.50, 0.150, 0.0),
    ("Tomsk", 56.50, 84.97, "Ku3", 640, -43.5, 0.74, 0.160, 0.0),
    ("Vladivostok", 43.12, 131.89, "Ku4", 720, -43.2, 0.44, 0.150, 0.0),
    ("Birobidzhan", 48.79, 132.92, "Ku4", 560, -43.8, 0.86, 0.165, 0.0),
    ("Sovetskaya Gavan", 48.97, 140.28, "Ku4", 640, -43.4, 0.60, 0.155, 0.0),
    ("Komsomolsk-on-Amur", 50.55, 137.01, "Ku4", 640, -43.5, 0.56, 0.155, 0.0),
)

#: users of the C band: wide dishes, weaker beams, levels that rain hardly touches
C8: tuple[Row, ...] = (
    ("Sochi", 43.60, 39.73, "C1", 800, -43.1, 1.30, 0.145, 0.0),
    ("Arkhangelsk", 64.54, 40.54, "C1", 720, -43.4, 1.60, 0.150, 0.0),
    ("Perm", 58.01, 56.25, "C1", 880, -43.0, 1.40, 0.145, 0.0),
    ("Samara", 53.20, 50.15, "C1", 960, -42.8, 1.20, 0.140, 0.0),
    ("Barnaul", 53.35, 83.76, "C2", 800, -43.2, 1.50, 0.150, 0.0),
    ("Dudinka", 69.41, 86.18, "C2", 640, -43.7, 1.80, 0.155, 0.0),
    ("Nakhodka", 42.82, 132.88, "C2", 880, -43.0, 1.30, 0.145, 0.0),
    ("Magadan", 59.56, 150.81, "C2", 640, -43.8, 1.80, 0.160, 0.0),
)
