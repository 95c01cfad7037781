// Grids whose nodes stand elsewhere than on a lattice: thin parts have one curved cell through their thickness.
//
// A point's place is the spline of its cell's nodes, X(s) = sum_a N_a(s) P_a, s in spacings from the cell's node. The same
// splines carry the motion, so that a rigid one is carried exactly whatever the nodes' places are, and
//   dN_a/dX = J^-T dN_a/ds,  J = sum_a P_a (dN_a/ds)^T.
// Isoparametric: Hughes, Cottrell, Bazilevs, "Isogeometric analysis", 2005.
#pragma once

namespace mphygs {

/// One cell's map from s to space.
struct CurvedCell {
    double node[27][3];  // P_a [m]

    /// X and J at s, J by columns: jacobian[c] is dX/ds_c.
    void at(const double s[3], double (&place)[3], double (&jacobian)[3][3]) const;

    /// Where in the cell, or beyond it by its own polynomial, a place is. Newton's method, from the middle.
    /// Throws std::invalid_argument where it does not arrive, or the map turns inside out on the way.
    void find(const double place[3], double (&s)[3]) const;

    /// Lengths of the cell's three edges through s [m].
    void lengths(const double s[3], double (&length)[3]) const;

    /// Turns derivatives by s into such by X.
    void turn(const double s[3], double (&gradient)[27][3]) const;
};

}  // namespace mphygs
