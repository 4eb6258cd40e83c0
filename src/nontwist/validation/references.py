"""The literature that sources of checks name, beside the labels of the paper."""

REFERENCES = {
    "Bishop 1975": "R. L. Bishop, There is more than one way to frame a curve, Amer. Math. Monthly 82 (1975) 246–251",
    "Blanes, Casas & Ros 2000": "S. Blanes, F. Casas, J. Ros, Improved high order integrators based on the Magnus "
    "expansion, BIT 40 (2000) 434–450",
    "Bloch": "A. M. Bloch, Nonholonomic Mechanics and Control, Springer",
    "Brüls, Cardona & Arnold 2012": "O. Brüls, A. Cardona, M. Arnold, Lie group generalized-α time integration of "
    "constrained flexible multibody systems, Mech. Mach. Theory 48 (2012) 121–137",
    "Codman 1934": "E. A. Codman, The Shoulder, Boston 1934",
    "Girard, Gauss–Bonnet": "the solid angle of a polygon is 2π less the sum of its exterior angles",
    "Hairer, Lubich & Wanner": "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer "
    "2006",
    "Kahan & Li 1997": "W. Kahan, R.-C. Li, Composition constants for raising the orders of unconventional schemes for "
    "ordinary differential equations, Math. Comp. 66 (1997) 1089–1099",
    "Landau & Lifshitz": "L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., Butterworth-Heinemann 1976",
    "Modin & Verdier 2020": "K. Modin, O. Verdier, What makes nonholonomic integrators work?, Numer. Math. 145 "
    "(2020) 405–435",
    "Montgomery 1991": "R. Montgomery, How much does the rigid body rotate? A Berry's phase from the 18th century, "
    "Amer. J. Phys. 59 (1991) 394–398",
    "Simo & Wong 1991": "J. C. Simo, K. K. Wong, Unconditionally stable algorithms for rigid body dynamics that "
    "exactly preserve energy and momentum, Int. J. Numer. Methods Eng. 31 (1991) 19–52",
    "Suslov 1946": "G. K. Suslov, Theoretical Mechanics, Moscow 1946 (in Russian)",
    "Suzuki 1990": "M. Suzuki, Fractal decomposition of exponential operators, Phys. Lett. A 146 (1990) 319–323",
    "Wang, Jüttler, Zheng & Liu 2008": "W. Wang, B. Jüttler, D. Zheng, Y. Liu, Computation of rotation minimizing "
    "frames, ACM Trans. Graph. 27 (2008) 2:1–2:18",
    "Whittaker": "E. T. Whittaker, Analytical Dynamics of Particles and Rigid Bodies, 4th ed., Cambridge 1937",
    "Wittenburg 1977": "J. Wittenburg, Dynamics of Systems of Rigid Bodies, Teubner 1977",
}
